"""Coloured points and surfaces as glTF: colours are amounts of light, and nothing lights them."""

import json
import struct

import numpy as np
import pytest

from tisfm.formats.glb import colors_of, glb_points, glb_surface, light_of

CORNERS = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32)
COLORS = np.array([[255, 128, 0], [0, 64, 255], [188, 188, 188]], np.uint8)


def parts(data):
    """Return the tree and the bytes of a GLB file."""
    magic, version, size, length, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def colors_in(data):
    """Return the colours at the vertices as the file has them, from 0 to 1."""
    tree, binary = parts(data)
    (mesh,) = tree["meshes"]
    (primitive,) = mesh["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["COLOR_0"]]
    assert accessor["componentType"] == 5121 and accessor["normalized"]
    assert accessor["type"] == "VEC4"
    begin = tree["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor.get(
        "byteOffset", 0
    )
    found = np.frombuffer(binary, np.uint8, 4 * accessor["count"], begin).reshape(-1, 4)
    assert (found[:, 3] == 255).all()
    return found[:, :3] / 255


@pytest.mark.parametrize("data", [
    glb_points(CORNERS, COLORS), glb_surface(CORNERS, np.array([[0, 1, 2]]), COLORS),
], ids=["points", "surface"])  # fmt: skip
def test_colours_are_amounts_of_light_and_unlit(data):
    light = colors_in(data)
    # By the standard: 128 is 0.2159 of the light, 64 is 0.0513, 188 is 0.5029.
    expected = [[1, 0.2159, 0], [0, 0.0513, 1], [0.5029, 0.5029, 0.5029]]
    np.testing.assert_allclose(light, expected, atol=0.5 / 255 + 1e-3)
    tree, _ = parts(data)
    (material,) = tree["materials"]
    assert material["doubleSided"] and "KHR_materials_unlit" in material["extensions"]
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert tree["meshes"][0]["primitives"][0]["material"] == 0


def test_colours_come_back_as_well_as_8_bits_of_light_tell():
    coded = np.arange(256, dtype=np.uint8)
    error = np.abs(colors_of(light_of(coded)).astype(int) - coded)
    assert error[0] == error[255] == 0
    assert error.max() <= 13 and error[60:].max() <= 2  # few steps of light in the dark

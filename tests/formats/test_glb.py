"""Coloured points and surfaces as glTF: colours are amounts of light, and nothing lights them."""

import json
import struct
from io import BytesIO

import numpy as np
import pytest
import trimesh

from tisfm.formats.glb import glb_points, glb_surface, srgb_from_light

CORNERS = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32)
COLORS = np.array([[255, 128, 0], [0, 64, 255], [188, 188, 188]], np.uint8)


def parts(data):
    """Return the tree and the bytes of a GLB file."""
    magic, version, size, length, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def colors_in(data, count=3):
    """Return the colours at the vertices as the file has them, from 0 to 1."""
    tree, binary = parts(data)
    (mesh,) = tree["meshes"]
    (primitive,) = mesh["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["COLOR_0"]]
    assert accessor["componentType"] == 5126 and "normalized" not in accessor  # float32
    assert accessor["type"] == "VEC3" and accessor["count"] == count
    begin = tree["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor.get(
        "byteOffset", 0
    )
    found = np.frombuffer(binary, "<f4", 3 * accessor["count"], begin).reshape(-1, 3)
    np.testing.assert_allclose(accessor["min"], found.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(accessor["max"], found.max(axis=0), rtol=1e-6)
    return found


@pytest.mark.parametrize("data", [
    glb_points(CORNERS, COLORS), glb_surface(CORNERS, np.array([[0, 1, 2]]), COLORS),
], ids=["points", "surface"])  # fmt: skip
def test_colours_are_amounts_of_light_and_unlit(data):
    light = colors_in(data)
    # By the standard: 128 is 0.2159 of the light, 64 is 0.0513, 188 is 0.5029.
    expected = [[1, 0.2159, 0], [0, 0.0513, 1], [0.5029, 0.5029, 0.5029]]
    np.testing.assert_allclose(light, expected, atol=1e-4)
    tree, _ = parts(data)
    (material,) = tree["materials"]
    assert material["doubleSided"] and "KHR_materials_unlit" in material["extensions"]
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert tree["meshes"][0]["primitives"][0]["material"] == 0


@pytest.mark.parametrize("kind", ["points", "surface"])
def test_trimesh_loads_the_colours(kind):
    """As linear light in 8 bits; for a surface, with the option to leave the material out."""
    if kind == "points":
        (loaded,) = trimesh.load(BytesIO(glb_points(CORNERS, COLORS)), "glb").geometry.values()
        found = loaded.colors
    else:
        data = glb_surface(CORNERS, np.array([[0, 1, 2]]), COLORS)
        options = {"file_type": "glb", "skip_materials": True}
        (loaded,) = trimesh.load(BytesIO(data), **options).geometry.values()
        found = loaded.visual.vertex_colors
        # With its material, they are a vertex attribute, as in the file.
        (unlit,) = trimesh.load(BytesIO(data), "glb").geometry.values()
        kept = srgb_from_light(unlit.visual.vertex_attributes["color"])
        np.testing.assert_array_equal(kept, COLORS)
    where = [np.linalg.norm(loaded.vertices - corner, axis=1).argmin() for corner in CORNERS]
    light = 255 * np.array([[1, 0.2159, 0], [0, 0.0513, 1], [0.5029, 0.5029, 0.5029]])
    assert np.abs(found[where, :3] - light).max() <= 1
    assert (found[:, 3] == 255).all()


def test_every_colour_survives_a_glb_file():
    colors = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    light = colors_in(glb_points(np.zeros((256, 3), np.float32), colors), count=256)
    np.testing.assert_array_equal(srgb_from_light(light), colors)


def test_light_of_8_bits_has_few_steps_in_the_dark():
    coded = np.arange(256)
    light = np.where(coded <= 10, coded / 12.92 / 255, ((coded / 255 + 0.055) / 1.055) ** 2.4)
    error = np.abs(srgb_from_light(np.rint(255 * light).astype(np.uint8)).astype(int) - coded)
    assert error[0] == error[255] == 0
    assert error.max() <= 13 and error[60:].max() <= 2

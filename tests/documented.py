"""The files that examples of the documentation name, small, made once for all tests."""

import numpy as np

import tisfm
from tests.datasets.made import make_middlebury
from tests.reconstruction.films import walk
from tisfm.cli.command_line import main
from tisfm.formats import write_png
from tisfm.scenes import bodies_film, bodies_path, two_blocks

FRAMES, HEIGHT, WIDTH = 9, 180, 240  # of the film of a room; examples name its frames and size
BODY_FRAMES = 8  # of the film of moving bodies


def make(folder):
    """Write images, results of `run` and `reconstruct`, and a sequence whose truth is known."""
    make_pictures(folder)
    make_middlebury(folder / "middlebury")
    assert main(["run", str(folder / "frames"), "-o", str(folder / "results"), "--preset", "fast",
                 "--focal", "64", "--no-figures"]) == 0  # fmt: skip
    tisfm.Interpretation.load(folder / "results" / "frame0.npz").save(folder / "pair.npz")
    film = walk(FRAMES, HEIGHT, WIDTH)
    make_calibrated(folder / "calibrated", film)
    assert main(["reconstruct", str(folder / "calibrated" / "images"), "-o", str(folder / "walk"),
                 "--preset", "fast", "--focal", str(film.camera.focal)]) == 0  # fmt: skip
    bodies = bodies_film(bodies_path(BODY_FRAMES), HEIGHT, WIDTH)
    settings = tisfm.Settings.preset("fast", motion="objects")
    found = tisfm.reconstruct(
        bodies.frames, camera=bodies.camera, settings=settings, labels=bodies.labels
    )
    found.save(folder / "bodies")


def make_pictures(folder):
    """Write two frames, and a folder of three."""
    scene = two_blocks(48, 64)
    (folder / "frames").mkdir()
    for k, frame in enumerate((scene.frame0, scene.frame1, scene.frame0)):
        write_png(folder / "frames" / f"frame{k}.png", frame)
    write_png(folder / "frame0.png", scene.frame0)
    write_png(folder / "frame1.png", scene.frame1)


def make_calibrated(folder, film):
    """Write a film in the layout "calibrated", with its depth in mm."""
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    for k, (frame, depth) in enumerate(zip(film.frames, film.depth, strict=True)):
        write_png(folder / "images" / f"{k:03d}.png", frame)
        write_png(folder / "depth" / f"{k:03d}.png", np.rint(1000 * depth).astype(np.uint16))
    focal, (cx, cy) = film.camera.focal, film.camera.center_for(*film.frames.shape[1:])
    (folder / "camera.txt").write_text(f"fx fy cx cy\n{focal} {focal} {cx} {cy}\n")
    rows = (" ".join(map(repr, pose[:3].ravel().tolist())) for pose in film.poses)
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")

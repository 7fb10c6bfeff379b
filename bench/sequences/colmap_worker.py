"""Process that runs the incremental mapping of pycolmap on a sequence.

It needs pycolmap and NumPy, but neither tisfm nor the rest of the bench.
``colmap_worker.py survey`` prints the version of pycolmap as JSON, or why it is missing.
``colmap_worker.py`` reads a line of JSON, ``{"images": FOLDER, "output": FOLDER, "camera":
[f, cx, cy], "names": [NAME, …], "threads": N}``, and prints one: the poses of the frames, camera to
world, the segment of each frame, the seconds, and the peak memory in bytes. It uses SIFT of every
frame, sequential matching, and the incremental mapper with default options and fixed intrinsics.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

STATUS = Path("/proc/self/status")
HALF = 0.5  # px: centre of the first pixel in pycolmap


def survey() -> dict[str, str]:
    """Return the version, or the reason why pycolmap cannot run."""
    try:
        import pycolmap
    except ImportError as error:
        return {"reason": str(error)}
    return {"version": pycolmap.__version__}


def run(request: dict[str, Any]) -> dict[str, Any]:
    import pycolmap

    images, output = Path(request["images"]), Path(request["output"])
    database, threads = output / "database.db", request["threads"]
    focal, cx, cy = request["camera"]
    pycolmap.set_random_seed(0)
    reader = pycolmap.ImageReaderOptions(
        camera_model="SIMPLE_PINHOLE", camera_params=f"{focal},{cx + HALF},{cy + HALF}"
    )
    extraction = pycolmap.FeatureExtractionOptions(num_threads=threads)
    matching = pycolmap.FeatureMatchingOptions(num_threads=threads)
    options = pycolmap.IncrementalPipelineOptions(num_threads=threads)
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.mapper.num_threads = threads
    start_time = time.perf_counter()
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
    )
    pycolmap.match_sequential(database, matching_options=matching)
    models = pycolmap.incremental_mapping(database, images, output, options)
    seconds = time.perf_counter() - start_time
    poses: list[Any] = [None] * len(request["names"])
    piece = [-1] * len(poses)
    number = {name: index for index, name in enumerate(request["names"])}
    for count, model in enumerate(sorted(models.values(), key=lambda m: -m.num_reg_images())):
        for image in model.images.values():
            index = number[image.name]
            if image.has_pose and poses[index] is None:  # models may share images
                motion = image.cam_from_world()
                rotation = motion.rotation.matrix().T
                pose = np.eye(4)
                pose[:3, :3], pose[:3, 3] = rotation, -rotation @ motion.translation
                poses[index], piece[index] = pose.tolist(), count
    return {"poses": poses, "piece": piece, "seconds": seconds, "peak": peak()}


def peak() -> int:
    if STATUS.exists():
        line = next(row for row in STATUS.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) * 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # the output of libraries must not mix with the answer
    answer = survey() if sys.argv[1:] == ["survey"] else run(json.loads(sys.stdin.readline()))
    answers.write(json.dumps(answer) + "\n")
    answers.flush()

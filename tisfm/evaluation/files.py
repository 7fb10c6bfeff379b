"""The files that `tisfm eval` writes."""

import json
import os
import platform
import re
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.datasets import DatasetPair, LoadedPair
from tisfm.evaluation.pairs import Evaluation, PairEvaluation, as_record
from tisfm.folders.result_folder import InputFiles, make_result_folder, make_subfolder
from tisfm.formats import atomic_write, write_flo
from tisfm.interpretation import Interpretation
from tisfm.metrics import endpoint_error_map
from tisfm.settings import Settings
from tisfm.show import (
    DEPTH_ERROR_RANGE,
    ERROR_RANGE,
    depth_error_figure,
    error_figure,
    flow_figure,
    save_figure,
)
from tisfm.version import __version__

EVALUATION_RECORD = "eval.json"
_DPI = 250  # px per inch: high enough to keep all pixels of a panel
_FILE_ENDINGS = ("_flow.flo", "_flow.png", "_error.png", "_depth_error.png")
_RECORDED_PACKAGES = ("numpy", "opencv-python-headless", "taichi")


class EvaluationWriter:
    """Writes the files of evaluated pairs into a folder, and one record of all pairs.

    For a pair NAME of DATASET: ``DATASET/NAME_flow.flo``; with a true flow,
    ``DATASET/NAME_flow.png`` (estimated beside true flow) and ``DATASET/NAME_error.png`` (end-point
    error, on one scale for all pairs); with a true and an estimated depth,
    ``DATASET/NAME_depth_error.png`` (both on one scale, and the relative error). The record,
    ``eval.json``, is written first and replaced after every pair: it always lists the pairs with
    complete files. At the end, its "complete" becomes true.

    Raises OSError if the folder cannot be made or written to.

    Raises ValueError if an output file is an input file of a pair.
    """

    def __init__(
        self,
        folder: str | Path,  # made if it does not exist
        *,
        camera: Camera | None,  # the camera of every pair, if the user gave one
        settings: Settings,
        # The pairs to evaluate. No output may replace their files.
        pairs: Iterable[DatasetPair] = (),
    ) -> None:
        self.folder = Path(folder)
        self._stems: dict[DatasetPair, str] = {}
        self._used_stems: set[str] = set()
        pairs = list(pairs)
        self._inputs = InputFiles(
            value for pair in pairs for value in vars(pair).values() if isinstance(value, Path)
        )
        self._inputs.refuse(self.folder / EVALUATION_RECORD)
        for pair in pairs:
            self._inputs.refuse(*self._files(self._stem(pair)))
        make_result_folder(folder)
        self._record: dict[str, Any] = {
            "version": __version__,
            "versions": {
                "python": platform.python_version(),
                **{package: _version(package) for package in _RECORDED_PACKAGES},
            },
            "machine": platform.platform(),
            "processor": platform.processor() or platform.machine(),
            "cores": os.cpu_count(),
            "arch": runtime.running_arch(),
            "threads": runtime.threads(),
            "camera": None if camera is None else asdict(camera),
            "settings": asdict(settings),
            "error_range_px": list(ERROR_RANGE),
            "depth_error_range": list(DEPTH_ERROR_RANGE),
            "complete": False,
            "pairs": [],
            "dataset_means": {},
            "mean": None,
        }
        self._write_record()

    def write(
        self,
        evaluation: PairEvaluation,
        result: Interpretation | None,  # none for a failed pair, which is only recorded
        loaded: LoadedPair | None,  # the loaded files; None for a failed pair
    ) -> None:
        """Write all files of a pair, then the record.

        Raises OSError if a file cannot be written.
        """
        stem = None
        if result is not None and loaded is not None:
            stem = self._stem(evaluation.pair)
            self._inputs.refuse(*self._files(stem))
            make_subfolder((self.folder / stem).parent)
            self._write_files(f"{self.folder / stem}", evaluation, result, loaded)
        self._record["pairs"].append({**as_record(evaluation), "outputs": stem})
        self._write_record()

    def _write_files(
        self, path: str, evaluation: PairEvaluation, result: Interpretation, loaded: LoadedPair
    ) -> None:
        write_flo(f"{path}_flow.flo", result.flow)
        if loaded.flow is not None and evaluation.errors is not None:
            title = f"{evaluation.label}, EPE {evaluation.errors.endpoint:.3f} px"
            figure = flow_figure(result.flow, loaded.flow, title=title)
            save_figure(f"{path}_flow.png", figure, _DPI)
            error = endpoint_error_map(result.flow, loaded.flow)
            save_figure(f"{path}_error.png", error_figure(error, title=title), _DPI)
        if loaded.depth is not None and evaluation.depth is not None:
            title = f"{evaluation.label}, abs-rel {evaluation.depth.abs_rel:.3f}"
            figure = depth_error_figure(result.depth, loaded.depth, title=title)
            save_figure(f"{path}_depth_error.png", figure, _DPI)

    def finish(
        self,
        evaluation: Evaluation,  # evaluation of the written pairs
    ) -> None:
        """Add the means and medians to the record, and mark it as complete.

        Raises OSError if the record cannot be written.
        """
        means = {**evaluation.dataset_means, "": evaluation.mean}
        records = {name: None if mean is None else asdict(mean) for name, mean in means.items()}
        self._record["mean"] = records.pop("")
        self._record["dataset_means"] = records
        self._record["complete"] = True
        self._write_record()

    def _stem(self, pair: DatasetPair) -> str:
        """Return a unique beginning of the file names of a pair, inside the folder."""
        if pair not in self._stems:
            parts = (pair.dataset, pair.name)
            stem = "/".join(re.sub(r"[^\w.+-]+", "_", part).lstrip(".") or "_" for part in parts)
            number = 1
            unique_stem = stem
            while unique_stem.lower() in self._used_stems:
                number += 1
                unique_stem = f"{stem}_{number}"
            self._used_stems.add(unique_stem.lower())
            self._stems[pair] = unique_stem
        return self._stems[pair]

    def _files(self, stem: str) -> list[Path]:
        """Return all files that a pair can have."""
        return [self.folder / f"{stem}{ending}" for ending in _FILE_ENDINGS]

    def _write_record(self) -> None:
        self._inputs.refuse(self.folder / EVALUATION_RECORD)
        text = json.dumps(self._record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        with atomic_write(self.folder / EVALUATION_RECORD) as file:
            file.write(text.encode("utf-8"))


def _version(package: str) -> str | None:
    try:
        return version(package)
    except ModuleNotFoundError:  # other builds of OpenCV have other package names
        return None

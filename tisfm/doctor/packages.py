"""Findings about Python, tisfm, and the packages that it requires."""

import platform
import sys
from collections.abc import Iterator, Mapping
from importlib import metadata

from tisfm.doctor.finding import Finding
from tisfm.doctor.machine import RAISE_LIMIT, is_limited
from tisfm.doctor.trials import TrialResults

# Distributions whose modules have another name.
_MODULES = {
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "scikit-image": "skimage",
    "pyyaml": "yaml",
    "openexr": "OpenEXR",
}
_OPENCV = (
    "opencv-python",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-contrib-python-headless",
)
_DEVELOPER_EXTRAS = ("test", "docs", "dev")
_USES = {
    "video": "videos, damaged ones too, decoded by PyAV",
    "mesh": "meshes",
    "cluster": "many machines",
    "view": "the viewer in the browser",
    "export": "depth and maps as EXR",
}


def requirements() -> tuple[dict[str, str], dict[str, dict[str, str]], str]:
    """Return the required packages, the packages of each extra, and a text if they are unreadable.

    The packages are version specifiers by distribution. They are empty if tisfm is not installed or
    its metadata cannot be read. The text is empty if they were read.
    """
    base: dict[str, str] = {}
    extras: dict[str, dict[str, str]] = {}
    try:
        from packaging.requirements import Requirement

        for line in metadata.requires("tisfm") or ():
            requirement = Requirement(line)
            name, versions = requirement.name.lower(), str(requirement.specifier)
            if requirement.marker is None:
                base[name] = versions
                continue
            for extra in metadata.metadata("tisfm").get_all("Provides-Extra") or ():
                if requirement.marker.evaluate({"extra": extra}) and name != "tisfm":
                    extras.setdefault(extra, {})[name] = versions
    except metadata.PackageNotFoundError:
        return {}, {}, ""
    except Exception as error:  # packaging, or the metadata, is broken
        return {}, {}, f"{type(error).__name__}: {' '.join(str(error).split())}"
    return base, {k: v for k, v in extras.items() if k not in _DEVELOPER_EXTRAS}, ""


def module_of(distribution: str) -> str:
    """Return the module that a distribution is imported by."""
    return _MODULES.get(distribution, distribution.replace("-", "_"))


def examine_python() -> Finding:
    """Return the finding about the version and the folder of Python."""
    version = platform.python_version()
    text = f"{version}, {platform.system()} {platform.machine()}, {sys.executable}"
    if not (3, 10) <= sys.version_info[:2] < (3, 14):
        return Finding(
            "Python",
            "wrong",
            text,
            "Taichi has builds for Python 3.10 to 3.13: make an environment with one",
        )
    return Finding("Python", "ok", text)


def examine_tisfm(results: TrialResults, requirements_error: str = "") -> Iterator[Finding]:
    """Yield findings about the version of tisfm and its import.

    `requirements_error` says why its requirements cannot be read; empty if they can.
    """
    try:
        version = metadata.version("tisfm")
    except metadata.PackageNotFoundError:
        yield Finding(
            "tisfm",
            "warning",
            "not installed, so its requirements are not known",
            "in the checkout: pip install -e .",
        )
        return
    error = results.get("tisfm", {}).get("error")
    if error:
        yield Finding(
            "tisfm",
            "wrong",
            f"{version} cannot be imported: {error}",
            RAISE_LIMIT
            if is_limited()
            else "first do what the lines below say; if they say nothing: pip install "
            "--force-reinstall tisfm",
        )
    else:
        yield Finding("tisfm", "ok", version)
    if requirements_error:
        yield Finding(
            "Packages",
            "wrong",
            "the requirements of tisfm cannot be read, so no package is checked: "
            f"{requirements_error}",
            "pip install --force-reinstall packaging",
        )


def examine_base(base: Mapping[str, str], results: TrialResults) -> Iterator[Finding]:
    """Yield a finding about each required package."""
    for name, versions in base.items():
        yield _examine_package(
            name, versions, results, missing="wrong", command=f"pip install '{name}{versions}'"
        )


def examine_extras(
    extras: Mapping[str, Mapping[str, str]], results: TrialResults
) -> Iterator[Finding]:
    """Yield a finding about each optional package."""
    for extra, packages in extras.items():
        command = f"pip install 'tisfm[{extra}]'"
        use = _USES.get(extra, extra)
        for name, versions in packages.items():
            finding = _examine_package(name, versions, results, missing="absent", command=command)
            advice = f"for {use}: {command}" if finding.verdict == "absent" else finding.advice
            yield Finding(f"{name} [{extra}]", finding.verdict, finding.text, advice)


def examine_opencv() -> Finding:
    """Return the finding about builds of OpenCV that overwrite each other's files."""
    versions = {name: version for name in _OPENCV if (version := _version(name)) is not None}
    build_list = ", ".join(f"{name} {version}" for name, version in versions.items())
    if len(versions) > 1:
        return Finding(
            "OpenCV builds",
            "wrong",
            f"{build_list}: they have the same files, and the last one installed wins",
            f"pip uninstall {' '.join(versions)}; then pip install opencv-python-headless",
        )
    if versions and "opencv-python-headless" not in versions:
        return Finding(
            "OpenCV builds",
            "warning",
            f"{build_list}, not the build that tisfm requires",
            f"pip uninstall {' '.join(versions)}; then pip install opencv-python-headless",
        )
    return Finding("OpenCV builds", "ok", build_list or "none")


def _examine_package(
    name: str, versions: str, results: TrialResults, *, missing: str, command: str
) -> Finding:
    version = _version(name)
    error = results.get(module_of(name), {}).get("error")
    if version is None and (error or module_of(name) not in results):
        return Finding(name, "wrong" if missing == "wrong" else "absent", "not installed", command)
    if error:
        return Finding(
            name,
            "wrong" if missing == "wrong" else "warning",
            f"{version} cannot be imported: {error}",
            RAISE_LIMIT if is_limited() else f"pip install --force-reinstall '{name}{versions}'",
        )
    if version is None:
        return Finding(name, "ok", "version unknown")
    if not _is_suitable(version, versions):
        return Finding(
            name,
            "wrong" if missing == "wrong" else "warning",
            f"{version}, but tisfm requires {versions}",
            command,
        )
    return Finding(name, "ok", version)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except Exception:  # damaged metadata, too
        return None


def _is_suitable(version: str, versions: str) -> bool:
    try:
        from packaging.specifiers import SpecifierSet

        return SpecifierSet(versions).contains(version, prereleases=True)
    except Exception:  # unknown: no complaint
        return True

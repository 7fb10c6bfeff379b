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
_FOR_DEVELOPERS = ("test", "docs", "dev")
_USES = {
    "video": "videos, damaged ones too, decoded by PyAV",
    "mesh": "meshes",
    "cluster": "many machines",
    "view": "the viewer in the browser",
    "export": "depth and maps as EXR",
}


def requirements() -> tuple[dict[str, str], dict[str, dict[str, str]], str]:
    """Return the required packages, those of each extra, and why they cannot be read, if so.

    Packages are version specifiers by distribution. They are empty if tisfm is not installed or its
    metadata cannot be read.
    """
    base: dict[str, str] = {}
    extras: dict[str, dict[str, str]] = {}
    try:
        from packaging.requirements import Requirement

        for line in metadata.requires("tisfm") or ():
            asked = Requirement(line)
            name, versions = asked.name.lower(), str(asked.specifier)
            if asked.marker is None:
                base[name] = versions
                continue
            for extra in metadata.metadata("tisfm").get_all("Provides-Extra") or ():
                if asked.marker.evaluate({"extra": extra}) and name != "tisfm":
                    extras.setdefault(extra, {})[name] = versions
    except metadata.PackageNotFoundError:
        return {}, {}, ""
    except Exception as error:  # packaging, or the metadata, is broken
        return {}, {}, f"{type(error).__name__}: {' '.join(str(error).split())}"
    return base, {k: v for k, v in extras.items() if k not in _FOR_DEVELOPERS}, ""


def module_of(distribution: str) -> str:
    """Return the module that a distribution is imported by."""
    return _MODULES.get(distribution, distribution.replace("-", "_"))


def about_python() -> Finding:
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


def about_tisfm(tried: TrialResults, unread: str = "") -> Iterator[Finding]:
    """Yield findings about the version of tisfm and its import.

    `unread` says why its requirements cannot be read; empty if they can.
    """
    try:
        version = metadata.version("tisfm")
    except metadata.PackageNotFoundError:
        yield Finding(
            "tisfm",
            "warning",
            "not installed; what it asks for is not known",
            "in the checkout: pip install -e .",
        )
        return
    error = tried.get("tisfm", {}).get("error")
    if error:
        yield Finding(
            "tisfm",
            "wrong",
            f"{version} cannot be imported: {error}",
            RAISE_LIMIT
            if is_limited()
            else "first do what the lines below say; if nothing: pip install --force-reinstall "
            "tisfm",
        )
    else:
        yield Finding("tisfm", "ok", version)
    if unread:
        yield Finding(
            "Packages",
            "wrong",
            f"what tisfm asks for cannot be read, so that none is looked at: {unread}",
            "pip install --force-reinstall packaging",
        )


def about_base(base: Mapping[str, str], tried: TrialResults) -> Iterator[Finding]:
    """Yield a finding about each required package."""
    for name, versions in base.items():
        yield _about(
            name, versions, tried, missing="wrong", command=f"pip install '{name}{versions}'"
        )


def about_extras(extras: Mapping[str, Mapping[str, str]], tried: TrialResults) -> Iterator[Finding]:
    """Yield a finding about each optional package."""
    for extra, packages in extras.items():
        command = f"pip install 'tisfm[{extra}]'"
        use = _USES.get(extra, extra)
        for name, versions in packages.items():
            found = _about(name, versions, tried, missing="absent", command=command)
            advice = f"for {use}: {command}" if found.verdict == "absent" else found.advice
            yield Finding(f"{name} [{extra}]", found.verdict, found.text, advice)


def about_opencv() -> Finding:
    """Return the finding about builds of OpenCV that overwrite each other's files."""
    found = {name: version for name in _OPENCV if (version := _version(name)) is not None}
    listed = ", ".join(f"{name} {version}" for name, version in found.items())
    if len(found) > 1:
        return Finding(
            "OpenCV builds",
            "wrong",
            f"{listed}: they have the same files, and the last one installed wins",
            f"pip uninstall {' '.join(found)}; then pip install opencv-python-headless",
        )
    if found and "opencv-python-headless" not in found:
        return Finding(
            "OpenCV builds",
            "warning",
            f"{listed}, another build than tisfm asks for",
            f"pip uninstall {' '.join(found)}; then pip install opencv-python-headless",
        )
    return Finding("OpenCV builds", "ok", listed or "none")


def _about(name: str, versions: str, tried: TrialResults, *, missing: str, command: str) -> Finding:
    version = _version(name)
    error = tried.get(module_of(name), {}).get("error")
    if version is None and (error or module_of(name) not in tried):
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
    if not _suits(version, versions):
        return Finding(
            name,
            "wrong" if missing == "wrong" else "warning",
            f"{version}, but tisfm asks for {versions}",
            command,
        )
    return Finding(name, "ok", version)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except Exception:  # damaged metadata, too
        return None


def _suits(version: str, versions: str) -> bool:
    try:
        from packaging.specifiers import SpecifierSet

        return SpecifierSet(versions).contains(version, prereleases=True)
    except Exception:  # unknown: no complaint
        return True

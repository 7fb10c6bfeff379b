"""Settings as rows of a table, compared with a preset."""

from dataclasses import asdict, dataclass
from typing import Any, get_args

from tisfm.settings import Preset, Settings


@dataclass(frozen=True, kw_only=True)
class SettingRow:
    """A setting: name, value, and the value of the preset if it differs."""

    name: str
    value: str
    preset_value: str | None


def nearest_preset(settings: Settings) -> str:
    """Return the preset with the fewest different settings."""
    values = asdict(settings)

    def differing(name: Preset) -> int:
        preset = asdict(Settings.preset(name, motion=settings.motion))
        return sum(preset[key] != value for key, value in values.items())

    return min(("balanced", *get_args(Preset)), key=differing)


def setting_rows(settings: Settings) -> list[SettingRow]:
    """Return a row for every setting; settings that differ from the nearest preset come first."""
    preset = asdict(Settings.preset(nearest_preset(settings), motion=settings.motion))  # type: ignore[arg-type]
    rows = [
        SettingRow(
            name=name,
            value=_shown(value),
            preset_value=None if preset[name] == value else _shown(preset[name]),
        )
        for name, value in asdict(settings).items()
    ]
    return sorted(rows, key=lambda row: row.preset_value is None)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_shown, value))
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:.4g}" if isinstance(value, float) else str(value)

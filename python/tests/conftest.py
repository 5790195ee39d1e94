"""Simulated recordings that several tests read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

import seabearing as sb

SCENARIOS = Path(__file__).parents[2] / "scenarios"

@dataclass
class Pass:
    """A simulated vessel pass."""

    recording: str
    station: str


@pytest.fixture(scope="session")
def short_pass(tmp_path_factory: pytest.TempPathFactory) -> Pass:
    """Five seconds of four channels at 64 kHz."""
    written = sb.simulate(SCENARIOS / "short-pass.toml", tmp_path_factory.mktemp("pass"))
    return Pass(written["recording"][0], written["station"][0])


@pytest.fixture(scope="session")
def ocean_bottom(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """An hour at the ocean bottom: a file for each component."""
    folder = tmp_path_factory.mktemp("bottom")
    (folder / "scenarios").mkdir()
    for name in ("ocean-bottom.toml", "ocean-bottom-station.toml"):
        text = (SCENARIOS / name).read_text()
        (folder / "scenarios" / name).write_text(text.replace("duration_s = 21600.0", "duration_s = 3600.0"))
    sb.propagation_table(
        SCENARIOS / "ocean-profile.csv", depth_m=4340, rows=720, out=folder / "out" / "ocean-table.toml"
    )
    return sb.simulate(folder / "scenarios" / "ocean-bottom.toml", folder / "out" / "hour")

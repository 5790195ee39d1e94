"""Vessels in underwater recordings: the recorder's own core, for notebooks.

    import seabearing as sb

    run = sb.process("recordings", station="east.toml")
    run.frame("track")

What a record holds and its units: ``docs/records.md`` of the project. Angles in records are degrees, times seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Union

from . import _native
from ._native import SeabearingError
from .inputs import made
from .recording import Recording
from .run import Run, Spectra

if TYPE_CHECKING:
    from datetime import datetime

    import numpy as np
    import numpy.typing as npt
    import obspy

__all__ = ["Recording", "Run", "SeabearingError", "Spectra", "process", "propagation_table", "read", "simulate"]

Path = Union[str, PathLike[str]]
#: Files or folders, samples of shape (n, 4), or an ObsPy stream.
Input = Union[Path, Sequence[Path], "npt.NDArray[np.generic]", "obspy.Stream"]
Time = Union[str, "datetime", "np.datetime64"]
Progress = Callable[[float], object]


def process(
    recording: Input,
    *,
    station: Path,
    rate_hz: float | None = None,
    start: Time | None = None,
    from_time: Time | None = None,
    to_time: Time | None = None,
    levels: float | None = None,
    propagation: Path | None = None,
    name_offset: str | None = None,
    progress: Progress | None = None,
) -> Run:
    """Runs the recorder over a recording, exactly as it would have run at sea.

    Args:
        recording: Files or folders (WAV, FLAC, miniSEED, SAC, archives of them); or samples of shape (n, 4), integers
            being codes of a 24-bit converter (``int16``: of a 16-bit one), floats parts of full scale, NaN missing; or
            an ObsPy stream.
        station: Station file (TOML), or StationXML of one station.
        rate_hz: Samples a second, for samples alone.
        start: UTC of the first sample, where the recording does not tell it.
        from_time, to_time: Only what was recorded from then and before then.
        levels: Also measure levels, over intervals of so many seconds.
        propagation: Propagation table for a station that StationXML describes; else one is traced.
        name_offset: Offset from UTC of times in file names that do not tell it, as ``+10:00``.
        progress: Is called with the share that is done, five times a second.

    Raises:
        SeabearingError: What cannot be done, in one line: what, where and what to do.
    """
    with made(recording, station, rate_hz, start, from_time, to_time, propagation, name_offset) as asked:
        return Run(_native.process(asked, levels, progress))


def read(
    recording: Input,
    *,
    station: Path,
    rate_hz: float | None = None,
    start: Time | None = None,
    from_time: Time | None = None,
    to_time: Time | None = None,
    propagation: Path | None = None,
    name_offset: str | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Reads a recording as the recorder gets it: four channels at its rate, gaps filled with NaN.

    Arguments and errors are those of :func:`process`.
    """
    with made(recording, station, rate_hz, start, from_time, to_time, propagation, name_offset) as asked:
        return Recording(_native.read(asked, progress))


def simulate(scenario: Path, out: Path) -> dict[str, list[str]]:
    """Simulates a scenario (``docs/simulate.md``) into a folder.

    Returns:
        Paths of what was written, by kind: ``recording``, ``truth``, ``station`` and, at the ocean bottom, ``tracks``
        and ``table``.
    """
    written: dict[str, list[str]] = {}
    for kind, path in _native.simulate(scenario, out):
        written.setdefault(kind, []).append(path)
    return written


def propagation_table(profile: Path, *, depth_m: float, out: Path, rows: int = 1429) -> None:
    """Traces the interference table that an ocean-bottom station's file names.

    Args:
        profile: Sound-speed profile, CSV with the columns ``depth_m,speed_m_s``.
        depth_m: Depth of the flat floor, m.
        out: The table to write; its folder is made.
        rows: Ranges, 70 m apart, the first at 0.
    """
    _native.propagation_table(profile, depth_m, rows, out)

"""What users hand over, as the native half takes it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ._native import Samples, SeabearingError

if TYPE_CHECKING:
    import numpy.typing as npt

    from ._native import Asked

#: Code of full scale of a 24-bit converter.
FULL_SCALE = 2**23


@contextmanager
def made(
    recording: Any,
    station: str | PathLike[str],
    rate_hz: float | None,
    start: str | datetime | np.datetime64 | None,
    from_time: str | datetime | np.datetime64 | None,
    to_time: str | datetime | np.datetime64 | None,
    propagation: str | PathLike[str] | None,
    name_offset: str | None,
) -> Iterator[Asked]:
    """The arguments; files that they need exist until the end of the block."""
    asked: Asked = {
        "station": station,
        "propagation": propagation,
        "files": [],
        "codes": None,
        "start": instant("start", start),
        "from_time": instant("from_time", from_time),
        "to_time": instant("to_time", to_time),
        "name_offset": name_offset,
    }
    if rate_hz is not None and not isinstance(recording, np.ndarray):
        raise SeabearingError("rate_hz is for samples alone: files and streams tell theirs")
    if isinstance(recording, np.ndarray):
        if rate_hz is None:
            raise SeabearingError("samples alone do not tell their rate: say rate_hz")
        asked["codes"] = (codes(recording).tobytes(), float(rate_hz))
        yield asked
    elif isinstance(recording, (str, PathLike)):
        asked["files"] = [fspath(recording)]
        yield asked
    elif hasattr(recording, "traces") and hasattr(recording, "write"):
        with tempfile.TemporaryDirectory() as folder:
            asked["files"] = [fspath(path) for path in written(recording, Path(folder))]
            yield asked
    else:
        asked["files"] = [fspath(path) for path in recording]
        yield asked


def instant(name: str, time: str | datetime | np.datetime64 | None) -> str | None:
    """A time as RFC 3339."""
    if time is None or isinstance(time, str):
        return time
    if isinstance(time, np.datetime64):
        return str(time.astype("datetime64[ns]")) + "Z"
    # ObsPy's times know their datetime.
    time = getattr(time, "datetime", time)
    if not isinstance(time, datetime):
        raise SeabearingError(f"{name} {time!r}: not a time; RFC 3339 or a datetime was expected")
    if time.tzinfo is None:
        time = time.replace(tzinfo=timezone.utc)
    return time.astimezone(timezone.utc).isoformat().replace("+00:00", "Z")


def codes(samples: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Codes of a 24-bit converter, shape (n, 4), of what has that shape."""
    if samples.ndim != 2 or samples.shape[1] != 4 or samples.shape[0] == 0:
        raise SeabearingError(f"samples of shape {samples.shape}: (n, 4) was expected, an instant a row")
    if samples.dtype == np.int16:
        scaled = samples.astype(np.int32) * 256
        # What was clipped is clipped.
        scaled[samples == 32767] = FULL_SCALE - 1
    elif samples.dtype.kind == "f":
        # Half precision ends at 65504: codes are beyond that.
        samples = samples.astype(np.float32) if samples.dtype.itemsize < 4 else samples
        # As when floating-point files are read.
        whole = np.clip(np.rint(samples * float(FULL_SCALE)), -FULL_SCALE, FULL_SCALE - 1)
        scaled = np.where(np.isfinite(samples), whole, Samples.MISSING).astype(np.int32)
    elif samples.dtype == np.int32:
        scaled = samples
    else:
        raise SeabearingError(f"samples of type {samples.dtype}: int16, int32 or floating point was expected")
    return np.ascontiguousarray(scaled, dtype="<i4")


def written(stream: Any, folder: Path) -> list[Path]:
    """An ObsPy stream as miniSEED files, one for each trace: what is masked in one is a gap between two."""
    parts = cast("list[Any]", stream.split().traces)
    if not parts:
        raise SeabearingError("the stream has no samples")
    files = []
    for number, trace in enumerate(parts):
        part = folder / f"{number:06}.mseed"
        # Samples of other types are no codes of miniSEED.
        if trace.data.dtype.kind in "iu" and trace.data.dtype != np.int32:
            trace.data = trace.data.astype(np.int32)
        trace.write(fspath(part), format="MSEED")
        files.append(part)
    return files

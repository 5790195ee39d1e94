"""What cannot be done is said in one line, and an interruption ends the work."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import numpy as np
import pytest

import seabearing as sb
from conftest import Pass


def test_one_line_says_what_and_where(short_pass: Pass, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    (tmp_path / "bad.toml").write_text("[station]\nid = 1\nname = 'x'\nkind = 'arrray'\n[sampling]\nrate_hz = 64000\n")
    good = np.zeros((64000, 4))
    for recording, changed, words in [
        ("nothing.wav", {}, "nothing.wav"),
        (tmp_path / "notes.txt", {}, "not a recording"),
        (tmp_path, {}, "no recording"),
        ([], {}, "no recording given"),
        (short_pass.recording, {"station": "nothing.toml"}, "nothing.toml"),
        (short_pass.recording, {"station": tmp_path / "bad.toml"}, "arrray"),
        (short_pass.recording, {"from_time": "noon"}, "from_time noon"),
        (short_pass.recording, {"from_time": "2024-05-01T09:00:03Z", "to_time": "2024-05-01T09:00:01Z"}, "later"),
        (short_pass.recording, {"from_time": 7}, "from_time 7"),
        (short_pass.recording, {"name_offset": "ten"}, "name_offset ten"),
        (short_pass.recording, {"rate_hz": 64000.0}, "rate_hz"),
        (short_pass.recording, {"levels": -1.0}, "levels -1"),
        (good, {}, "say rate_hz"),
        (good, {"rate_hz": 0.0}, "above 0"),
        (good[:, :3], {"rate_hz": 64000.0}, "(n, 4)"),
        (good[:0], {"rate_hz": 64000.0}, "(n, 4)"),
        (good.astype(np.int64), {"rate_hz": 64000.0}, "int64"),
    ]:
        arguments = {"station": short_pass.station, **changed}
        with pytest.raises(sb.SeabearingError) as error:
            sb.process(recording, **arguments)
        assert words in str(error.value) and "\n" not in str(error.value), str(error.value)


def test_progress_is_told_and_may_end_it(short_pass: Pass) -> None:
    samples = np.tile(sb.read(short_pass.recording, station=short_pass.station).codes, (12, 1))
    shares: list[float] = []
    sb.process(samples, rate_hz=64000, station=short_pass.station, progress=shares.append)
    assert shares and all(0 <= share <= 1 for share in shares) and shares == sorted(shares)

    def enough(_: float) -> None:
        raise StopIteration("enough")

    with pytest.raises(StopIteration, match="enough"):
        sb.process(samples, rate_hz=64000, station=short_pass.station, progress=enough)


def test_an_interruption_ends_it(short_pass: Pass) -> None:
    samples = np.tile(sb.read(short_pass.recording, station=short_pass.station).codes, (12, 1))
    # What is started in the background of a shell ignores it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(0.3, signal.raise_signal, [signal.SIGINT]).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            for _ in range(100):
                sb.process(samples, rate_hz=64000, station=short_pass.station)
    finally:
        signal.signal(signal.SIGINT, before)


def test_what_is_left_out_is_logged(short_pass: Pass, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    with caplog.at_level("DEBUG", logger="seabearing"):
        sb.process([short_pass.recording, tmp_path / "notes.txt"], station=short_pass.station)
    levels = {record.levelname for record in caplog.records if "notes.txt" in record.getMessage()}
    assert levels == {"WARNING"}
    assert any(record.levelname == "DEBUG" and "Wav" in record.getMessage() for record in caplog.records)

"""Recordings through the recorder, from files, arrays and streams."""

from __future__ import annotations

import json
import os
import subprocess
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import obspy
import pytest

import seabearing as sb
from conftest import Pass


def test_four_lines_from_a_file_to_a_frame(short_pass: Pass) -> None:
    run = sb.process(short_pass.recording, station=short_pass.station)
    frame = run.frame("bearing")
    assert len(frame) == run.counts["bearing"] >= 5
    assert str(frame["utc"].dtype) == "datetime64[ns, UTC]"
    assert frame["utc"][0].isoformat().startswith("2024-05-01T09:00:00")
    assert frame["azimuth_deg"].between(0, 360).all()
    assert frame["sd_azimuth_deg"].dtype == np.float64


def test_records_are_the_commands(short_pass: Pass, tmp_path: Path) -> None:
    run = sb.process(short_pass.recording, station=short_pass.station, levels=1)
    run.to_jsonl(tmp_path / "records.jsonl")
    lines = (tmp_path / "records.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == run.records()
    command = os.environ.get("SEABEARING")
    if command is None:
        pytest.skip("SEABEARING names no command to compare with")
    arguments = [command, "process", "--station", short_pass.station, short_pass.recording, "--levels", "1"]
    printed = subprocess.run(arguments, capture_output=True, check=True).stdout
    assert (tmp_path / "records.jsonl").read_bytes() == printed


def test_samples_give_what_the_file_gives(short_pass: Pass) -> None:
    recording = sb.read(short_pass.recording, station=short_pass.station)
    assert recording.samples.shape == (5 * 64000, 4)
    assert recording.start == np.datetime64("2024-05-01T09:00:00", "ns")
    start = datetime(2024, 5, 1, 9, tzinfo=timezone.utc)
    of_file = sb.process(short_pass.recording, station=short_pass.station).records()
    for samples in (recording.samples, recording.codes):
        of_samples = sb.process(samples, rate_hz=64000, start=start, station=short_pass.station)
        assert of_samples.records() == of_file


def test_a_part_of_the_time(short_pass: Pass) -> None:
    span = {"from_time": "2024-05-01T09:00:01Z", "to_time": datetime(2024, 5, 1, 9, 0, 3)}
    recording = sb.read(short_pass.recording, station=short_pass.station, **span)
    assert len(recording) == 2 * 64000
    assert recording.start == np.datetime64("2024-05-01T09:00:01", "ns")


def test_missing_and_clipped_samples_are_said(short_pass: Pass) -> None:
    samples = sb.read(short_pass.recording, station=short_pass.station).samples.copy()
    samples[1000:1100] = np.nan
    samples[5000, 2] = 1.5
    run = sb.process(samples, rate_hz=64000, station=short_pass.station)
    health = run.records("health")[-1]
    assert health["processed"] < 5 * 64000
    assert run.start is None and "utc" not in run.records("bearing")[0]
    whole = sb.read(samples, rate_hz=64000, station=short_pass.station)
    assert np.isnan(whole.samples[1000:1100]).all() and not np.isnan(whole.samples[1100:]).any()
    assert whole.samples[5000, 2] < 1.0


def test_sixteen_bits_are_scaled_and_stay_clipped(short_pass: Pass) -> None:
    samples = np.zeros((64000, 4), np.int16)
    samples[0] = [1, -1, 32767, -32768]
    codes = sb.read(samples, rate_hz=64000, station=short_pass.station).codes
    assert codes[0].tolist() == [256, -256, 2**23 - 1, -(2**23)]


def test_a_stream_gives_what_its_files_give(ocean_bottom: dict[str, list[str]]) -> None:
    station = ocean_bottom["station"][0]
    files = ocean_bottom["recording"]
    of_files = sb.process(files, station=station)
    assert of_files.counts["azimuth"] > 20
    stream = obspy.Stream()
    for path in files:
        stream += obspy.read(path)
    assert sb.process(stream, station=station).records() == of_files.records()
    # A gap that ObsPy masks is a gap for the recorder.
    stream.merge()
    begun = stream[0].stats.starttime
    for trace in stream:
        trace.data = np.ma.masked_array(trace.data)
        trace.data[50 * 600 : 50 * 700] = np.ma.masked
    gappy = sb.process(stream, station=station)
    assert [r["code"] for r in gappy.records("fault")] == ["Gap"]
    part = sb.read(stream, station=station, from_time=begun + 590, to_time=begun + 710)
    assert np.isnan(part.samples[:, 0]).sum() == 5000 and len(part) == 6000


def test_spectra_are_numpy(short_pass: Pass) -> None:
    spectra = sb.process(short_pass.recording, station=short_pass.station, levels=1).spectra()
    times, channels, cells = spectra.density_db.shape
    assert (times, channels) == (5, 4) and cells == len(spectra.frequency_hz) > 50
    assert spectra.channels == [0, 1, 2, 3] and spectra.reference == ["full scale"] * 4
    assert spectra.utc[1] - spectra.utc[0] == np.timedelta64(1, "s")
    assert (np.diff(spectra.frequency_hz) > 0).all() and np.isfinite(spectra.density_db).mean() > 0.9
    with pytest.raises(sb.SeabearingError, match="no levels were measured"):
        sb.process(short_pass.recording, station=short_pass.station).spectra()


def test_polars_has_the_same_values(short_pass: Pass) -> None:
    run = sb.process(short_pass.recording, station=short_pass.station)
    pandas, polars = run.frame("bearing"), run.polars("bearing")
    assert polars.columns == list(pandas.columns)
    assert polars["azimuth_deg"].to_list() == pandas["azimuth_deg"].to_list()
    assert polars["utc"].dt.timestamp("ns").to_list() == pandas["utc"].astype("int64").to_list()


def test_a_type_without_records_is_an_empty_frame(short_pass: Pass) -> None:
    run = sb.process(short_pass.recording, station=short_pass.station)
    assert run.frame("segment").empty and run.polars("segment").is_empty() and run.records("segment") == []

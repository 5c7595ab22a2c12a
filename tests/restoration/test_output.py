"""Rows, horizons and the record: whole, readable by others, honest about what is absent."""

import csv
import errno
import json
import os

import numpy as np
import pytest

from restoration import writing
from restoration.errors import OutputError
from restoration.output import RECORD, Diagnostics, write_lines, write_record
from restoration.scene import Line

LINES = [
    Line(
        "salt / sediment", "horizon", np.array([[0.0, -8000.5], [4571.0, -7800.25], [9142, -8e3]])
    ),
    Line("F1 & „F2“", "fault", np.array([[1.0, 2.0], [1 / 3, -4.0]])),
]


def test_rows_are_in_the_file_at_once(tmp_path):
    table = Diagnostics(tmp_path / "out" / "diagnostics.csv", ["step", "time", "note"])
    assert (tmp_path / "out" / "diagnostics.csv").read_text() == "step,time,note\n"
    table.write(step=1, time=np.float64(1 / 3), note="a, b")
    table.write(time=np.float64(1e-30), step=np.int64(2))
    with open(tmp_path / "out" / "diagnostics.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["step"] for row in rows] == ["1", "2"]
    assert [float(row["time"]) for row in rows] == [1 / 3, 1e-30]
    assert [row["note"] for row in rows] == ["a, b", ""]
    with pytest.raises(ValueError, match="no such column: tiem"):
        table.write(tiem=1)


def test_table_goes_on_after_an_interruption(tmp_path):
    path = tmp_path / "d.csv"
    table = Diagnostics(path, ["step", "time"])
    for step in range(5):
        table.write(step=step, time=0.5 * step)
    Diagnostics(path, ["step", "time"], keep=3).write(step=3, time=9)
    assert path.read_text().split() == ["step,time", "0,0.0", "1,0.5", "2,1.0", "3,9"]
    for columns, keep in ((["step"], 1), (["step", "time"], 5)):
        with pytest.raises(OutputError, match="not the table of this run"):
            Diagnostics(path, columns, keep=keep)
    path.rename(tmp_path / "elsewhere.csv")
    with pytest.raises(OutputError, match=r"not readable: .* begin anew with --fresh"):
        Diagnostics(path, ["step", "time"], keep=3)
    Diagnostics(path, ["step"])
    assert path.read_text() == "step\n"


def test_row_that_cannot_be_written(tmp_path):
    table = Diagnostics(tmp_path / "d.csv", ["step"])
    (tmp_path / "d.csv").unlink()
    (tmp_path / "d.csv").mkdir()
    with pytest.raises(OutputError, match=r"d.csv: not written: a folder stands where the file"):
        table.write(step=1)


def test_lines_are_geojson(tmp_path):
    shapely = pytest.importorskip("shapely")
    path = tmp_path / "horizons" / "1.geojson"
    write_lines(path, LINES, {"age_Ma": np.float64(2.5), "restored": True})
    data = json.loads(path.read_text())
    assert data["type"] == "FeatureCollection"
    assert data["crs"] is None
    for feature, line in zip(data["features"], LINES, strict=True):
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        assert shape.geom_type == "LineString"
        assert shape.is_valid
        np.testing.assert_array_equal(shapely.get_coordinates(shape), line.points)
        assert feature["properties"] == {
            "name": line.name,
            "kind": line.kind,
            "age_Ma": 2.5,
            "restored": True,
        }
    assert len(shapely.get_parts(shapely.from_geojson(path.read_text()))) == 2


def test_no_lines(tmp_path):
    write_lines(tmp_path / "none.geojson", [])
    assert json.loads((tmp_path / "none.geojson").read_text())["features"] == []


def test_record_has_every_entry_in_order(tmp_path):
    record = {
        "steps": np.int64(12),
        "wall_s": np.float32(0.5),
        "area_change": np.nan,
        "surface_relief_m": -np.inf,
        "wall_by_part_s": {"solve": 1.5},
        "ended_well": np.bool_(True),
        "horizons": [{"name": "top", "mean_m": np.float64(1), "max_m": np.inf}],
        "active": ("particles", np.array([1.0, np.nan])),
        "volume_by_rock_change": {"salt": 1e-9},
        "more": 3,
    }
    write_record(tmp_path / "run.json", record)
    found = json.loads((tmp_path / "run.json").read_text(), parse_constant=pytest.fail)
    assert list(found) == [*RECORD, "more"]
    assert found["steps"] == 12
    assert found["ended_well"] is True
    assert found["area_change"] is found["surface_relief_m"] is found["versions"] is None
    assert found["wall_by_part_s"]["solve"] == 1.5
    assert found["wall_by_part_s"]["setup"] is None
    assert list(found["wall_by_part_s"]) == list(RECORD["wall_by_part_s"])
    assert found["horizons"] == [{"name": "top", "mean_m": 1, "max_m": None}]
    assert found["active"] == ["particles", [1, None]]
    assert found["volume_by_rock_change"] == {"salt": 1e-9}


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_record_is_whole_or_the_old_one(tmp_path, monkeypatch, call):
    path = tmp_path / "run.json"
    write_record(path, {"steps": 1})

    def fail(*_):
        assert [entry.name for entry in tmp_path.iterdir()] != ["run.json"]
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing.os, call, fail)
    with pytest.raises(OutputError, match=r"run.json: not written: the disk is full"):
        write_record(path, {"steps": 2})
    monkeypatch.undo()
    assert json.loads(path.read_text())["steps"] == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.json"]


def test_record_that_is_interrupted_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "run.json"
    write_record(path, {"steps": 1})

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(writing.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_record(path, {"steps": 2})
    assert json.loads(path.read_text())["steps"] == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.json"]


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.EACCES, "you may not write here: write to another folder"),
        (errno.EROFS, "the disk is read-only"),
        (errno.EDQUOT, "the disk quota is used up"),
        (errno.EIO, "the disk fails"),
        (errno.ENXIO, "No such device or address"),
    ],
)
def test_faults_of_the_disk_say_what_to_do(tmp_path, monkeypatch, number, advice):
    def fail(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(writing.os, "replace", fail)
    with pytest.raises(OutputError, match=rf"run.json: not written: .*{advice}.*--out"):
        write_record(tmp_path / "run.json", {})

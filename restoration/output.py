"""What a run leaves in its folder beside the pictures: series, rows, horizons, the record."""

import csv
import json
import math
from pathlib import Path

import numpy as np

from restoration.errors import OutputError
from restoration.writing import disk_faults, replacing, write_text
from restoration.xdmf import WITHOUT, MeshSeries, ParticleSeries

__all__ = [
    "RECORD",
    "Diagnostics",
    "MeshSeries",
    "ParticleSeries",
    "write_json",
    "write_lines",
    "write_record",
]

# The entries of run.json in their order, with the entries of those that are tables.
RECORD = {
    "ended_well": (),
    "exit_code": (),
    "engine": (),
    "active": (),
    "case_sha256": (),
    "commit": (),
    "versions": ("dolfinx", "petsc", "numpy", "blas"),
    "ranks": (),
    "seed": (),
    "cells": (),
    "unknowns": (),
    "particles": (),
    "particles_lost": (),
    "steps": (),
    "stokes_solves": (),
    "factorisations": (),
    "krylov_iterations": (),
    "wall_s": (),
    "wall_by_part_s": (
        "setup",
        "mesh",
        "fields",
        "assemble",
        "solve",
        "advect",
        "surface",
        "guards",
        "output",
        "checkpoints",
        "certificate",
    ),
    "peak_rss_mb": (),
    "area_change": (),
    "volume_by_rock_change": (),
    "surface_rms_slope": (),
    "surface_relief_m": (),
    "dynamic_topography_m": (),
    "there_and_back": ("mean_m", "p99_m", "max_m"),
    "horizons": (),
    "restorability": ("gamma_max_per_s", "growth", "horizon_s", "verdict"),
    "certificate": (),
    "proof": (),
    "stopped": ("criterion", "horizon", "wanted_m", "value_m", "time_s", "duration_s", "met"),
    "viscosity_factor": (),
    "fitting_viscosity": (),
}


class Diagnostics:
    """A CSV table with a row per step; a row is in the file when `write` returns.

    Args:
        path: path of the table.
        columns: their names.
        keep: number of rows of an interrupted run that are kept.

    Raises:
        OutputError: the table could not be written, or the one to go on with does not fit.
    """

    def __init__(self, path, columns, keep=0):
        self.path = Path(path)
        self.columns = list(columns)
        rows = self._rows(keep) if keep else []
        with replacing(self.path) as temporary:
            _write_rows(temporary, [self.columns, *rows], "w")

    def write(self, **values):
        """Add a row of numbers and words; a column that is not given, or None, stays empty.

        Raises:
            OutputError: the row could not be written.
        """
        if unknown := set(values) - set(self.columns):
            raise ValueError(f"no such column: {', '.join(sorted(unknown))}")
        row = [values.get(name) for name in self.columns]
        with disk_faults(self.path):
            _write_rows(self.path, [row], "a")

    def _rows(self, keep):
        """Return the first rows of the table that is there."""
        try:
            with open(self.path, newline="", encoding="utf-8") as stream:
                header, *rows = list(csv.reader(stream)) or [[]]
        except (OSError, ValueError, csv.Error) as error:
            raise OutputError(f"{self.path}: not readable: {error}: {WITHOUT}") from error
        if header != self.columns or len(rows) < keep:
            raise OutputError(f"{self.path}: not the table of this run: {WITHOUT}")
        return rows[:keep]


def write_lines(path, lines, properties=None):
    """Write horizons and faults as GeoJSON in metres, without a reference system.

    Args:
        path: path of the file.
        lines: list of `restoration.scene.Line`.
        properties: what every line also tells, such as ``age_Ma``, besides its name and kind.

    Raises:
        OutputError: the file could not be written.
    """
    features = [
        {
            "type": "Feature",
            "properties": {"name": line.name, "kind": line.kind, **_plain(properties or {})},
            "geometry": {"type": "LineString", "coordinates": line.points.tolist()},
        }
        for line in lines
    ]
    # "crs": null keeps QGIS from taking metres for degrees.
    collection = {"type": "FeatureCollection", "crs": None, "features": features}
    write_text(path, json.dumps(collection, allow_nan=False) + "\n", durable=True)


def write_record(path, record):
    """Write run.json: the entries of `RECORD` in their order, then any others.

    An entry that is absent or not finite is null. The file outlives a loss of power.

    Args:
        path: path of the file.
        record: values by name.

    Raises:
        OutputError: the file could not be written.
    """
    record = dict.fromkeys(RECORD) | _plain(record)
    for name, entries in RECORD.items():
        if entries and record[name] is not None:
            record[name] = dict.fromkeys(entries) | record[name]
    write_json(path, record)


def write_json(path, entries):
    """Write numbers and texts by name as JSON; what is not finite is null.

    The file outlives a loss of power.

    Raises:
        OutputError: the file could not be written.
    """
    write_text(path, json.dumps(_plain(entries), indent=1, allow_nan=False) + "\n", durable=True)


def _plain(value):
    """Return a value as JSON knows it; what is not finite becomes None."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _write_rows(path, rows, mode):
    with open(path, mode, newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows(rows)

"""Reads the series of a run folder by VTK, as ParaView does, and compares them with the HDF5 files.

    python -m tests.vtk_reads FOLDER...

prints JSON: for every .xdmf file the number of its frames and of the arrays compared. It is a
process of its own, as VTK may end one.
"""

import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np

os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")


def stored(item, folder):
    """Return the array that a data item of an .xdmf file names."""
    if item.get("Format") == "XML":
        return np.array(item.text.split(), dtype=float)
    name, _, path = item.text.strip().partition(":")
    with h5py.File(folder / name, "r") as file:
        return file[path][:]


def same(read, kept, what):
    """Refuse values that are not those kept; VTK holds points in single precision."""
    kept = np.asarray(kept)
    if kept.ndim == 2 and kept.shape[1] < 3 == read.shape[-1]:
        kept = np.column_stack([kept, np.zeros((len(kept), 3 - kept.shape[1]))])
    assert read.shape == kept.shape, f"{what}: {read.shape} for {kept.shape}"
    assert np.array_equal(read, kept.astype(read.dtype), equal_nan=True), what


def compared(path):
    """Return how many frames and arrays of a series VTK reads as they are kept."""
    import pyvista

    reader = pyvista.get_reader(path)
    frames = ElementTree.parse(path).findall(".//Grid[@GridType='Uniform']")
    times = [float(frame.find("Time").get("Value")) for frame in frames]
    assert list(reader.time_values) == times, f"{path}: times {reader.time_values}"
    assert all(a < b for a, b in pairwise(times)), f"{path}: {times}"
    arrays = 0
    for moment, frame in zip(times, frames, strict=True):
        reader.set_active_time_value(moment)
        mesh = reader.read()
        where = f"{path} at {moment:g}"
        same(mesh.points, stored(frame.find("Geometry/DataItem"), path.parent), f"{where}: points")
        topology = frame.find("Topology/DataItem")
        if topology is not None:
            cells = stored(topology, path.parent)
            cells = cells.reshape(len(cells), -1)
            corners = mesh.cells.reshape(len(cells), -1)[:, 1:]
            same(np.sort(corners), np.sort(cells), f"{where}: cells")
        tables = {"Node": mesh.point_data, "Cell": mesh.cell_data, "Grid": mesh.field_data}
        for given in frame.findall("Attribute"):
            name, center = given.get("Name"), given.get("Center")
            kept = stored(given.find("DataItem"), path.parent)
            same(np.asarray(tables[center][name]), kept, f"{where}: {name}")
            arrays += 1
    return {"frames": len(frames), "arrays": arrays}


def read_by_vtk(folder):
    """Return what a child has found in a folder, by name of the file; see `compared`."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.vtk_reads", str(folder)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return {Path(path).name: found for path, found in json.loads(done.stdout).items()}


if __name__ == "__main__":
    paths = [path for name in sys.argv[1:] for path in sorted(Path(name).rglob("*.xdmf"))]
    print(json.dumps({str(path): compared(path) for path in paths}))

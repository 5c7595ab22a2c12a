"""Series of frames for ParaView: an .xdmf that describes and an .h5 that holds the numbers.

A frame is added to a copy of the .h5, which then takes the old one's place, so that a run killed
at any moment leaves a readable pair. To bound the copying, a file that has grown past `PART_SIZE`
is left alone and the frames go on in ``name-2.h5``, ``name-3.h5`` and so on; the one .xdmf shows
them all.

Floating-point numbers stay float64, so that a later comparison measures the runs and not the
rounding of a file; integers keep their size (units and rocks: int16).
"""

import json
import os
import shutil
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import h5py
import numpy as np

from restoration.errors import OutputError
from restoration.saved import part, parts
from restoration.units import YEAR
from restoration.writing import check_room, disk_faults, replacing, write_text

PART_SIZE = 64_000_000  # bytes after which the next .h5 is begun
OVERHEAD = 200_000  # bytes, more than an .h5 needs for a frame besides the numbers
WITHOUT = "the run cannot go on without it: put it back, or begin anew with --fresh"
NUMBERS = {"f8": "Float", "i2": "Short", "i4": "Int", "i8": "Int"}
# by their nodes
CELLS = {3: "Triangle", 6: "Triangle_6", 9: "Quadrilateral_9", 10: "Tetrahedron_10"}


class _Series:
    """What mesh and particle series share: the frames and the files.

    Args:
        path: path of the .xdmf; the .h5 stands beside it.
        attributes: what the .h5 tells about the run, by name: text, numbers, lists and arrays.
        until: elapsed time of the last frame of an interrupted run that is kept, s; None begins
            anew and removes all.

    Raises:
        OutputError: the files could not be written, or frames to go on with are missing.
    """

    def __init__(self, path, attributes=None, until=None):
        self.path = Path(path).with_suffix(".xdmf")
        self.attributes = attributes or {}
        self._frames = []  # (elapsed, description)
        self._part = 1
        self._last = {}  # points and topology as written last, and where they are
        self._keep(until)

    def _write(self, elapsed, time, topology_type, arrays):
        """Add a frame of ``arrays`` by label: points, topology, point/<name>, cell/<name>."""
        if self._frames and not elapsed > self._frames[-1][0]:
            raise ValueError(f"elapsed time must ascend: {elapsed} after {self._frames[-1][0]}")
        file = part(self.path, self._part)
        frame = f"{len(self._frames):06d}"
        place = {label: f"{file.name}:/frames/{frame}/{label}" for label in arrays}
        fresh = dict(arrays)
        for label, (array, where) in self._last.items():
            if np.array_equal(array, arrays[label]):
                place[label] = where
                del fresh[label]
        grid = _grid(elapsed, time, topology_type, arrays, place)
        self._append(file, frame, fresh, {"elapsed": elapsed, "grid": grid})
        self._frames.append((elapsed, grid))
        for label in {"points", "topology"} & set(fresh):
            self._last[label] = (fresh[label].copy(), place[label])
        if file.stat().st_size > PART_SIZE:
            self._part += 1
        self._describe()

    def _append(self, file, frame, arrays, about):
        """Store the arrays of a frame in a copy of ``file`` that takes its place."""
        size = sum(array.nbytes for array in arrays.values())
        with replacing(file) as temporary:
            old = file.stat().st_size if file.exists() else 0
            check_room(file, old + 2 * size + OVERHEAD)
            if old:
                shutil.copyfile(file, temporary)
            else:
                self._begin(temporary)
            _reserve(temporary, size + OVERHEAD)
            with h5py.File(temporary, "a") as h5:
                for stale in [name for name in h5["frames"] if name >= frame]:
                    del h5["frames"][stale]
                group = h5["frames"].create_group(frame)
                group.attrs.update(about)
                for label, array in arrays.items():
                    group[label] = array

    def _begin(self, file):
        """Make an .h5 without frames; in memory, since HDF5 may crash where a disk is full."""
        text = json.dumps(self.attributes, default=lambda value: value.tolist(), allow_nan=False)
        with h5py.File(file.name, "w", driver="core", backing_store=False) as h5:
            h5.create_group("frames")
            h5["attributes"] = np.bytes_(text.encode())
            h5.flush()
            file.write_bytes(h5.id.get_file_image())

    def _describe(self):
        """Write the .xdmf of all frames."""
        grids = "".join(grid for _, grid in self._frames)
        write_text(
            self.path,
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n'
            '<Grid Name="series" GridType="Collection" CollectionType="Temporal">\n'
            f"{grids}</Grid>\n</Domain></Xdmf>\n",
        )

    def _keep(self, until):
        """Take over the frames of an earlier run up to an elapsed time; remove what is later."""
        names = []
        for number, file in enumerate(parts(self.path), 1):
            found = {} if until is None else _abouts(file)
            kept = {name: about for name, about in found.items() if about[0] <= until}
            self._frames += kept.values()
            names += kept
            if kept:
                self._part = number
            else:
                with disk_faults(file):
                    file.unlink(missing_ok=True)
        whole = until is None or (self._frames and self._frames[-1][0] == until)
        if not whole or names != [f"{number:06d}" for number in range(len(names))]:
            raise OutputError(f"{part(self.path, 1)}: frames are missing: {WITHOUT}")
        if self._frames:
            self._describe()
        else:
            with disk_faults(self.path):
                self.path.unlink(missing_ok=True)


class MeshSeries(_Series):
    """Fields on a mesh, frame by frame; see `_Series` for the arguments."""

    def write(self, elapsed, points, cells, point_data=None, cell_data=None, time=None):
        """Add a frame. Geometry and topology that have not changed are not stored again.

        Args:
            elapsed: time run so far, forward and back, s; it must ascend.
            points: nodes, shape (n, 2) or (n, 3), m.
            cells: nodes of every cell: of triangles, shape (m, 3), or (m, 6) for quadratic ones:
                the corners, then the nodes in the middle of the edges 01, 12 and 20; of squares,
                shape (m, 9): four corners going round, the middles of their edges, the centre; of
                tetrahedra, shape (m, 10): corners, the middles of the edges 01, 12, 20, 03, 13, 23.
            point_data: values at the nodes by name, shape (n,), (n, 2) or (n, 3), SI.
            cell_data: values in the cells by name, of the same shapes, SI.
            time: model time, s; appears as field ``model_time_Myr``.

        Raises:
            OutputError: the files could not be written.
        """
        cells = np.asarray(cells, dtype=np.int32)
        arrays = {"points": _numbers("points", points, len(points)), "topology": cells}
        for name, values in (point_data or {}).items():
            arrays[f"point/{name}"] = _numbers(name, values, len(points))
        for name, values in (cell_data or {}).items():
            arrays[f"cell/{name}"] = _numbers(name, values, len(cells))
        self._write(elapsed, time, CELLS[cells.shape[1]], arrays)


class ParticleSeries(_Series):
    """A particle cloud, frame by frame; see `_Series` for the arguments.

    Give the names of the units and the outline as ``attributes``: `read_particles` returns them.
    """

    def write(self, elapsed, x, data=None, time=None):
        """Add a frame.

        Args:
            elapsed: time run so far, forward and back, s; it must ascend.
            x: positions, shape (n, 2) or (n, 3), m.
            data: values by name, such as ``unit``, shape (n,), (n, 2) or (n, 3), SI.
            time: model time, s; appears as field ``model_time_Myr``.

        Raises:
            OutputError: the files could not be written.
        """
        arrays = {"points": _numbers("points", x, len(x))}
        arrays["topology"] = np.arange(len(x), dtype=np.int32)
        for name, values in (data or {}).items():
            arrays[f"point/{name}"] = _numbers(name, values, len(x))
        self._write(elapsed, time, "Polyvertex", arrays)


def _abouts(file):
    """Return (elapsed, description) of every frame of an .h5, by name."""
    try:
        with h5py.File(file, "r") as h5:
            frames = {name: h5["frames"][name].attrs for name in sorted(h5["frames"])}
            return {n: (float(about["elapsed"]), about["grid"]) for n, about in frames.items()}
    except FileNotFoundError:
        return {}
    except (OSError, KeyError) as error:
        raise OutputError(f"{file}: not readable: {error}: {WITHOUT}") from error


def _reserve(file, size):
    """Make a file longer by ``size`` bytes, so that HDF5 meets no full disk."""
    with open(file, "r+b") as stream:
        os.posix_fallocate(stream.fileno(), 0, os.path.getsize(file) + size)


def _numbers(name, values, rows):
    """Return values as they are stored: float64 or integers, vectors with three components."""
    values = np.asarray(values)
    if values.shape not in ((rows,), (rows, 2), (rows, 3)) or rows == 0:
        raise ValueError(
            f"{name}: shape {values.shape}, expected ({rows},), ({rows}, 2) or (.., 3)"
        )
    if "/" in name:
        raise ValueError(f"{name}: a name may not contain a slash")
    if values.dtype.kind == "f":
        values = values.astype(np.float64, copy=False)
    elif values.dtype.str[1:] not in NUMBERS:
        values = values.astype(np.int16 if values.dtype.itemsize == 1 else np.int64)
    if values.shape[1:] == (2,) and name != "points":
        values = np.column_stack([values, np.zeros(rows)])
    return np.ascontiguousarray(values)


def _grid(elapsed, time, topology_type, arrays, place):
    """Return the XDMF of a frame; ``place`` says where each array is stored."""
    n_cells, corners = np.atleast_2d(arrays["topology"].T).T.shape

    def item(label):
        array = arrays[label]
        return (
            f'<DataItem Format="HDF" Dimensions="{" ".join(map(str, array.shape))}" '
            f'NumberType="{NUMBERS[array.dtype.str[1:]]}" Precision="{array.itemsize}">'
            f"{escape(place[label])}</DataItem>"
        )

    lines = [
        '<Grid Name="frame" GridType="Uniform">',
        f'<Time Value="{float(elapsed)!r}"/>',
        f'<Topology TopologyType="{topology_type}" NumberOfElements="{n_cells}" '
        f'NodesPerElement="{corners}">{item("topology")}</Topology>',
        f'<Geometry GeometryType="{"XYZ"[: arrays["points"].shape[1]]}">'
        f"{item('points')}</Geometry>",
    ]
    if time is not None:
        lines.append(
            '<Attribute Name="model_time_Myr" AttributeType="Scalar" Center="Grid">'
            f'<DataItem Format="XML" Dimensions="1" NumberType="Float" Precision="8">'
            f"{float(time) / (1e6 * YEAR)!r}</DataItem></Attribute>"
        )
    for label in list(arrays)[2:]:
        center, name = label.split("/")
        kind = "Scalar" if arrays[label].ndim == 1 else "Vector"
        center = {"point": "Node", "cell": "Cell"}[center]
        lines.append(
            f"<Attribute Name={quoteattr(name)} "
            f'AttributeType="{kind}" Center="{center}">{item(label)}</Attribute>'
        )
    return "\n".join([*lines, "</Grid>\n"])

"""Triangle meshes of sections whose edges lie on given lines."""

import signal
import threading

import numpy as np
import shapely
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from meshes.arrays import Arrays, assembled, nothing
from meshes.box import PLANE_WALLS, WALL_TAGS
from meshes.curves import SizeField, edges_along
from meshes.noding import MeshingError, cleaned, joined_pieces, place

SNAP = 1e-6  # of the height: what is nearer than this meets
ROUNDED = 1e-8  # of the size of a section: what gmsh is not to see
FLAT = 1e-9  # area per squared edges of a cell that is none
GMSH = {
    "General.Terminal": 0,
    "General.Verbosity": 0,
    # An error inside its parallel loops would end the process, with no message; what comes of one
    # is seen by `_labelled`.
    "General.AbortOnError": 0,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
}


def fitted_mesh(
    surface, base, lines, size, near=None, grading=0.3, snap=None, comm=MPI.COMM_WORLD, whole=False
):
    """Return a mesh of a section with edges along all lines.

    Lines may end on walls, on each other or inside, cross, close and coincide in part; what lies
    outside of the section is cut off. Corners, ends and junctions become nodes, and so do corners
    between long straight pieces; the other nodes lie on the lines about ``near`` apart, less where
    lines come close or one with shorter edges is near. A wall is meshed at ``size`` unless it is
    among the lines too.

    Args:
        surface: top line, shape (n, 2), x ascending, m.
        base: bottom line over the same x range, shape (m, 2), m.
        lines: polylines, each of shape (k, 2), m; the first point of a closed one is its last too.
        size: edge length away from the lines, m.
        near: edge length on the lines, m, one for all or one for each; ``size`` if None.
        grading: growth of the edge length per distance from the lines.
        snap: what is nearer than this is made to meet, m; a millionth of the height if None, at
            most a hundredth of the least ``near``.
        comm: MPI communicator; its first rank makes the mesh.
        whole: whether every rank gets the whole mesh, instead of a part.

    Returns:
        (`SectionMesh`, points), with the regions between the lines numbered in
        ``SectionMesh.regions`` and a point inside each region, shape (regions, 2), m.

    Raises:
        MeshingError: on all ranks.
    """
    near = np.broadcast_to(np.asarray(size if near is None else near, float), len(lines))
    least = min(near, default=size)
    surface, base = np.asarray(surface, dtype=float), np.asarray(base, dtype=float)
    snap = min(snap or SNAP * np.ptp(np.vstack([surface, base])[:, 1]), least / 100)
    result = None
    if comm.rank == 0:
        try:
            result = _arrays(surface, base, lines, (size, near, grading), snap)
        except (MeshingError, shapely.errors.GEOSException) as error:
            result = MeshingError(str(error))
    failed = comm.bcast(result if isinstance(result, MeshingError) else None)
    if failed:
        raise failed
    arrays, points = result or (nothing(), None)
    level = {name for name, y in (("surface", surface), ("base", base)) if np.ptp(y[:, 1]) == 0}
    tags = {name: WALL_TAGS[name] for name in PLANE_WALLS}
    flat = frozenset({"left", "right"} | level)
    if whole and comm.size > 1:
        return assembled(comm.bcast(arrays), tags, flat, MPI.COMM_SELF), comm.bcast(points)
    return assembled(arrays, tags, flat, comm), comm.bcast(points)


def _arrays(surface, base, lines, sizes, snap):
    """Return the `Arrays` of the whole mesh and the points in its regions."""
    ring = np.vstack([surface, base[::-1]])
    outline = shapely.Polygon(ring)
    if not (outline.is_valid and outline.area > 0):
        raise MeshingError(f"surface and base cross: {shapely.is_valid_reason(outline)}")
    sides = [np.vstack([base[end], surface[end]]) for end in (0, -1)]
    walls = [*sides, base, surface]
    size, near, grading = sizes
    kept = [(line, h) for line, h in zip(map(cleaned, lines), near, strict=True) if len(line) > 1]
    given, near = [line for line, _ in kept], np.array([h for _, h in kept])
    pieces = joined_pieces(walls, given, outline, snap)
    nodes, edges, tags = edges_along(pieces, walls, given, (size, near, grading), snap)
    x, cells = _triangulated(nodes, edges, tags, (size, min(near, default=size), grading))
    return _labelled(x, cells, edges, tags)


def _triangulated(nodes, edges, tags, sizes):
    """Return the nodes, the given ones first, and the cells that gmsh makes between edges.

    gmsh makes other triangles where the last digit of a point is another: two runs of one section,
    on one rank and on several, would part there as far as two meshes do. So it sees rounded nodes,
    and they are put back where they are.
    """
    import gmsh  # slow to load, and it takes the interrupt signal until finalize

    main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    try:
        gmsh.initialize([], False)
        if main:
            signal.signal(signal.SIGINT, handler)  # gmsh would let Ctrl-C end the process
        digits = -int(np.floor(np.log10(ROUNDED * np.ptp(nodes, axis=0).max())))
        x, cells = _meshed(gmsh, np.round(nodes, digits), edges, tags, sizes)
        x[: len(nodes)] = nodes
        return x, cells
    except MeshingError:
        raise
    except Exception as error:  # gmsh raises nothing narrower
        raise MeshingError(f"gmsh: {error}") from error
    finally:
        gmsh.finalize()
        if main:
            signal.signal(signal.SIGINT, handler)


def _meshed(gmsh, nodes, edges, tags, sizes):
    """Return what `_triangulated` does, in a gmsh that runs."""
    for name, value in GMSH.items():
        gmsh.option.setNumber(name, value)
    for row, (x, z) in enumerate(nodes.tolist(), start=1):
        gmsh.model.geo.addPoint(x, z, 0, tag=row)
    for row, (a, b) in enumerate((edges + 1).tolist(), start=1):
        gmsh.model.geo.addLine(a, b, row)
    gmsh.model.geo.addCurveLoop((1 + np.flatnonzero(tags)).tolist(), 1, reorient=True)
    gmsh.model.geo.addPlaneSurface([1], 1)
    gmsh.model.geo.synchronize()
    if not tags.all():
        gmsh.model.mesh.embed(1, (1 + np.flatnonzero(tags == 0)).tolist(), 2, 1)
    for row in range(1, len(edges) + 1):
        gmsh.model.mesh.setTransfiniteCurve(row, 2)
    gmsh.model.mesh.field.setAsBackgroundMesh(_field(gmsh, nodes, edges, sizes))
    gmsh.model.mesh.generate(2)
    tags, x, _ = gmsh.model.mesh.getNodes()
    cells = gmsh.model.mesh.getElementsByType(2)[1].reshape(-1, 3).astype(np.int64)
    row_of = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    row_of[tags] = np.arange(len(tags))
    return x.reshape(-1, 3)[:, :2].copy(), row_of[cells]


def _field(gmsh, nodes, edges, sizes):
    """Return the gmsh field of edge lengths: linear between the nodes and a grid."""
    size = sizes[0]
    h_at = SizeField(nodes[edges], sizes)
    low, high = nodes.min(axis=0) - size, nodes.max(axis=0) + size
    axes = [np.linspace(a, b, 2 + int((b - a) / size)) for a, b in zip(low, high, strict=True)]
    x = np.vstack([nodes, np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)])
    h = h_at(x)
    corners = Delaunay(x).simplices
    flat = np.zeros((len(corners), 12))
    flat[:, :3], flat[:, 3:6], flat[:, 9:] = x[corners, 0], x[corners, 1], h[corners]
    view = gmsh.view.add("h")
    gmsh.view.addListData(view, "ST", len(corners), flat.ravel())
    field = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
    return field


def _labelled(x, cells, edges, tags):
    """Return the `Arrays` of a mesh with its regions numbered, and a point in each region."""
    if not len(cells):
        raise MeshingError("gmsh made no cells; draw the lines farther apart")
    corners = x[cells]
    sides = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    slender = np.abs(area) / (sides**2).sum(axis=(1, 2))
    if slender.min() < FLAT:
        where = corners[np.argmin(slender)].mean(axis=0)
        raise MeshingError(f"flat cells near {place(where)}")
    ends = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    keys, key_of = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True)
    line_keys = edges[:, 0] << 32 | edges[:, 1]
    lost = edges[~np.isin(line_keys, keys)]
    if len(lost):
        raise MeshingError(f"a line was lost near {place(x[lost[0]].mean(axis=0))}")
    sides_of = np.where(np.isin(keys, line_keys[tags > 0]), 1, 2)
    torn = np.flatnonzero(np.bincount(key_of) != sides_of)
    if len(torn) or (area > 0).any() != (area > 0).all():
        row = np.flatnonzero(key_of == torn[0])[0] // 3 if len(torn) else np.argmin(area)
        raise MeshingError(f"cells overlap or leave a gap near {place(corners[row].mean(axis=0))}")
    order = np.argsort(key_of, kind="stable")
    twin = np.flatnonzero(key_of[order[:-1]] == key_of[order[1:]])
    free = twin[~np.isin(keys[key_of[order[twin]]], line_keys)]
    pairs = order[free] // 3, order[free + 1] // 3
    graph = coo_array((np.ones(len(free)), pairs), shape=(len(cells),) * 2)
    count, region = connected_components(graph, directed=False)
    roundness = np.abs(area) / np.hypot(sides[..., 0], sides[..., 1]).sum(axis=1)
    best = np.lexsort((-roundness, region))
    points = corners.mean(axis=1)[best[np.searchsorted(region[best], np.arange(count))]]
    used, cells = np.unique(cells, return_inverse=True)
    wall = tags > 0
    walls = np.searchsorted(used, edges[wall])
    regions = region.astype(np.int32)
    return Arrays(x[used], cells.reshape(-1, 3), regions, walls, tags[wall]), points

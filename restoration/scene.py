"""The scene: what a case asks for, resolved, in SI units and frozen.

Coordinates are ``(x, z)``: x to the right, z up, m. In a box z is 0 at the surface. A box with a
length has a third: ``(x, y, z)``, y from its front to its back.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

WALLS = ("left", "right", "base", "surface")
BOX_WALLS = (*WALLS, "front", "back")  # in three dimensions


def normal_axis(name, dim):
    """Return the axis across a wall in two or three dimensions; up is the last axis."""
    return {"left": 0, "right": 0, "front": 1, "back": 1}.get(name, dim - 1)


@dataclass(frozen=True)
class Rock:
    """A material.

    Attributes:
        name: name in the case.
        density: kg/m^3.
        viscosity: dynamic viscosity, Pa s.
        color: ``#rrggbb`` of the pictures.
    """

    name: str
    density: float
    viscosity: float
    color: str


@dataclass(frozen=True)
class Unit:
    """A mapped unit of the section (a layer); several units may be of one rock.

    Attributes:
        name: name of the layer or the polygons.
        rock: row of `Scene.rocks`.
        color: ``#rrggbb`` of the pictures; a shade of the rock's where a rock has several units.
    """

    name: str
    rock: int
    color: str


@dataclass(frozen=True, eq=False)
class Line:
    """A line of the section that moves with the rock and is reported: a horizon or a fault.

    Attributes:
        name: such as ``salt / sediment``; pieces of one horizon share their name.
        kind: ``horizon``, ``fault``, ``surface`` or ``edge``, the closed outline of a `Fault`.
        points: vertices in order, shape (n, 2), m.
    """

    name: str
    kind: str
    points: np.ndarray


@dataclass(frozen=True, eq=False)
class Sheet:
    """A horizon in three dimensions: a grid of points that move with the rock.

    Attributes:
        name: such as ``salt / sediment``.
        kind: ``horizon``.
        points: row by row along x, shape (n, 3), m.
        shape: rows (along y) and columns (along x).
    """

    name: str
    kind: str
    points: np.ndarray
    shape: tuple[int, int]


@dataclass(frozen=True)
class Fault:
    """A fault with a width and a rock: a band along a line of the kind ``fault``.

    Attributes:
        name: also of its unit, of its lines and of the lines ``edge`` around it.
        unit: row of `Scene.units`.
        width: m.
    """

    name: str
    unit: int
    width: float


@dataclass(frozen=True)
class Table:
    """A value that varies along a wall and in model time: linear between, constant beyond.

    Attributes:
        axis: coordinate along the wall: 0 for x, 1 for z.
        positions: along it, ascending, m; one where nothing varies along the wall.
        times: ascending, s; one where nothing varies in time.
        values: a row for each time, a value for each position.
    """

    axis: int
    positions: tuple[float, ...]
    times: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]

    def __call__(self, points, time=0.0):
        """Return the values at points (n, 2), m, and a model time, s; shape (n,)."""
        row = [np.interp(time, self.times, column) for column in zip(*self.values, strict=True)]
        return np.interp(points[:, self.axis], self.positions, row)

    @property
    def span(self):
        """Least and greatest value."""
        return min(map(min, self.values)), max(map(max, self.values))


def value_at(value, points, time):
    """Return a value of a wall at points and a model time, shape (n,).

    Args:
        value: a number, a `Table` or a function of points, as in `Wall`.
        points: shape (n, dim), m.
        time: s.
    """
    if isinstance(value, Table):
        return value(points, time)
    return value(points) if callable(value) else np.full(len(points), float(value))


@dataclass(frozen=True)
class Wall:
    """What happens on one wall, component by component along (x, z), or (x, y, z).

    Attributes:
        kind: ``no-slip``, ``free-slip``, ``velocity``, ``traction`` or, of the surface, ``free``:
            without traction, and in motion.
        velocity: prescribed components, m/s: a number, a `Table`, a function of points (n, dim),
            m, that gives (n,), or None where the component is not held.
        traction: force per area on the components that are not held, Pa: a number, a table or a
            function as above; 0 is stress-free.
    """

    kind: str
    velocity: tuple[float | Table | None, ...]
    traction: tuple[float | Table, ...]


@dataclass(frozen=True, eq=False)
class Outline:
    """The frame of a section with vertical sides.

    Attributes:
        surface: top line from left to right, shape (n, 2), n >= 2, x strictly ascending, m.
        base: bottom line from left to right over the same x range, shape (m, 2), m.
    """

    surface: np.ndarray
    base: np.ndarray

    @property
    def width(self):
        """Width, m."""
        return float(self.surface[-1, 0] - self.surface[0, 0])

    @property
    def height(self):
        """Greatest extent in z, m."""
        return float(self.surface[:, 1].max() - self.base[:, 1].min())

    @property
    def area(self):
        """Area between surface and base, m^2."""
        return float(
            np.trapz(self.surface[:, 1], self.surface[:, 0])
            - np.trapz(self.base[:, 1], self.base[:, 0])
        )


@dataclass(frozen=True)
class ParticlePlan:
    """How the particles are seeded, and what they move in.

    Attributes:
        per_cell: particles per mesh cell away from the horizons (mean).
        densify: how many times more within one cell size of a horizon.
        jitter: 0 for a regular pattern, 1 for a jitter of a full spacing.
        seed: of the random numbers.
        velocity: that they move in: ``conservative``, free of divergence at every point where the
            elements allow it (see `conservative`), or ``plain``, that of the elements.
    """

    per_cell: int
    densify: int
    jitter: float
    seed: int
    velocity: str = "conservative"


@dataclass(frozen=True)
class Transfer:
    """How rock is carried from particles to the fields.

    Attributes:
        density: ``hat`` (continuous, hat-weighted vertices), ``projection`` (linear too, with the
            moments of the particles), ``linear`` (a plane in each cell), ``quadrature`` (arithmetic
            mean of the particles around each quadrature point), ``cell`` (arithmetic mean per
            cell) or ``lines`` (linear, with the exact moments of the rock between the lines).
        viscosity: one of the same but the projection, which overshoots; by ``lines`` it is
            constant in each cell.
        mean: of the viscosity: ``harmonic``, ``geometric`` or ``arithmetic``.
    """

    density: str
    viscosity: str
    mean: str


@dataclass(frozen=True)
class RefinePlan:
    """Where the mesh is finer, and how often that is found anew.

    Attributes:
        levels: how often a cell may be halved.
        where: of ``interfaces``, ``faults`` and ``velocity-gradient``.
        every: number of steps after which the mesh is adapted again.
    """

    levels: int
    where: tuple[str, ...]
    every: int


@dataclass(frozen=True)
class MeshPlan:
    """What the mesh is made of.

    Attributes:
        element: pair of elements, a name in `forms.elements.ELEMENTS`.
        interfaces: ``particles`` where they carry the rock through the mesh, ``fitted`` where mesh
            lines follow it, ``auto`` where they do and particles go on once no mesh can.
        refine: `RefinePlan`, or None for a mesh that stands still.
    """

    element: str = "P2-P1"
    interfaces: str = "particles"
    refine: RefinePlan | None = None


@dataclass(frozen=True)
class SolverPlan:
    """How the Stokes matrix is solved.

    Attributes:
        name: ``direct``, ``fieldsplit`` or ``auto``.
        options: PETSc options that replace those of the solver, (name, value) pairs.
        reproducible: whether of several ranks the first one alone solves directly: MUMPS on several
            adds up in the order that messages come in, so that no two runs agree to the last bit.
    """

    name: str = "auto"
    options: tuple[tuple[str, str], ...] = ()
    reproducible: bool = True


@dataclass(frozen=True)
class Air:
    """Air that is solved for ("sticky air"): a light and weak layer above the surface.

    Attributes:
        thickness: above the highest point of the surface, m.
        density: kg/m^3.
        viscosity: Pa s; far below that of the rock, far above that of air.
    """

    thickness: float
    density: float
    viscosity: float


@dataclass(frozen=True)
class SurfacePlan:
    """How a free surface moves.

    Attributes:
        theta: share of the step for which the weight of the moved surface counts in the flow
            (free-surface stabilisation, Kaus et al. 2010); 0 is explicit, 1/2 of second order.
        reverse: ``auto``, ``integrate``, ``slave`` or ``stabilise``, see `surface_modes`.
        motion: of the top nodes of the mesh, ``vertical`` or ``normal``.
        limit: part of the longest stable step of an explicit surface that a step may take.
        air: `Air`, or None.
        noise: how well the surface is known, m.
        tolerance: error of the restored surface that can be borne, m.
    """

    theta: float = 0.0
    reverse: str = "auto"
    motion: str = "vertical"
    limit: float = 0.5
    air: Air | None = None
    noise: float = 1.0
    tolerance: float = 100.0


@dataclass(frozen=True)
class StopPlan:
    """What ends a march before its last mark.

    Attributes:
        criterion: ``flat``, ``relief``, ``depth`` or ``flattest``.
        horizon: what is measured, in words.
        names: of its lines; a tuple for each horizon that is measured by itself.
        value: where the run stops, m; None for the least.
        known: duration that is known, s, or None.
        start: what is measured of the section as given, m.
    """

    criterion: str
    horizon: str
    names: tuple[tuple[str, ...], ...]
    value: float | None
    known: float | None = None
    start: float | None = None


@dataclass(frozen=True)
class TimePlan:
    """When the run passes where.

    Attributes:
        marks: model times to pass, s; the first is the start; decreasing ones restore.
        scheme: name of one of `advection.SCHEMES`.
        courant: cells a particle may cross in a step.
        min_steps: least number of steps between two marks.
        tolerance: what 99 of 100 points may be off after a step of ``rk3``, or the move at which
            the iterations of ``implicit-midpoint`` end, m; None for no control, or the default.
        stop: `StopPlan`, or None.
    """

    marks: tuple[float, ...]
    scheme: str
    courant: float
    min_steps: int
    tolerance: float | None = None
    stop: StopPlan | None = None


@dataclass(frozen=True)
class CertificatePlan:
    """What the certificate of a restoration is about.

    Attributes:
        noise: how well the given section is known, m, root mean square.
        tolerance: mean error of a restored horizon or rock that can be borne, m.
    """

    noise: float = 1.0
    tolerance: float = 100.0


@dataclass(frozen=True)
class OutputPlan:
    """What is written, and when.

    Attributes:
        at: ``marks``, or the number of steps between two frames.
        fields: of velocity, pressure, density, viscosity, strain_rate.
        particles: whether the particle series is written.
        arrows: whether pictures carry velocity arrows.
        exaggeration: vertical exaggeration of the pictures.
    """

    at: str | int
    fields: tuple[str, ...]
    particles: bool
    arrows: bool
    exaggeration: float


@dataclass(frozen=True, eq=False)
class Cloud:
    """Particles given by the user instead of seeded ones.

    Attributes:
        x: positions, shape (n, 2), m.
        unit: row of `Scene.units`, shape (n,), int16.
    """

    x: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True, eq=False)
class Scene:
    """A section and what is to be done with it.

    Attributes:
        title: of the pictures.
        outline: the frame; in three dimensions that of every vertical cut along x.
        rocks: the rock table.
        units: the mapped units, each of one rock.
        unit_at: maps points (n, dim), m, to rows of `units`, shape (n,), int16.
        lines: horizons, faults and the edges of those with a width, which move with the rock.
        walls: wall by name, one for each of `WALLS`, in three dimensions of `BOX_WALLS`.
        gravity: acceleration downwards, m/s^2.
        cells: mesh columns and rows of squares; each becomes four triangles or a quadrilateral. In
            three dimensions cubes along x, y and z, each of twelve tetrahedra.
        particles, transfer, time, output: the plans.
        cloud: the particles where the case gives them, else None.
        notes: remarks on the input for the user, such as slivers that were closed.
        mesh, solver, surface: the plans of the mesh, the linear solver and a free surface.
        certificate: `CertificatePlan`, or None for no certificate.
        length: along y, m; None in two dimensions.
        sheets: horizons of three dimensions; they have no ``lines``.
    """

    title: str
    outline: Outline
    rocks: tuple[Rock, ...]
    units: tuple[Unit, ...]
    unit_at: Callable[[np.ndarray], np.ndarray]
    lines: tuple[Line, ...]
    walls: dict[str, Wall]
    gravity: float
    cells: tuple[int, ...]
    particles: ParticlePlan
    transfer: Transfer
    time: TimePlan
    output: OutputPlan
    cloud: Cloud | None
    notes: tuple[str, ...]
    mesh: MeshPlan = MeshPlan()
    solver: SolverPlan = SolverPlan()
    faults: tuple[Fault, ...] = ()
    surface: SurfacePlan = SurfacePlan()
    certificate: CertificatePlan | None = CertificatePlan()
    length: float | None = None
    sheets: tuple[Sheet, ...] = ()

    @property
    def dim(self):
        """Dimensions, 2 or 3."""
        return 2 if self.length is None else 3

    @property
    def extent(self):
        """Width, length in three dimensions, and height, m."""
        along = () if self.length is None else (self.length,)
        return (self.outline.width, *along, self.outline.height)

    @property
    def free(self):
        """Whether the surface is free, so that it moves."""
        return self.walls["surface"].kind == "free"

    @property
    def air(self):
        """The `Air` above a free surface, or None."""
        return self.surface.air if self.free else None

    @property
    def unit_density(self):
        """Density of every unit, shape (units,), kg/m^3."""
        return np.array([self.rocks[unit.rock].density for unit in self.units])

    @property
    def unit_viscosity(self):
        """Viscosity of every unit, shape (units,), Pa s."""
        return np.array([self.rocks[unit.rock].viscosity for unit in self.units])

    @property
    def one_viscosity(self):
        """Whether one viscosity fills the whole section, so that one factorisation serves."""
        return self.air is None and len(set(self.unit_viscosity.tolist())) == 1

    def normal_velocity(self, name):
        """Return the velocity across a wall, m/s; see the function of this name."""
        return normal_velocity(name, self.walls[name], self.outline)

    @property
    def closed(self):
        """Whether the normal velocity is held on every wall, so that pressure floats."""
        return all(self.normal_velocity(name) is not None for name in self.walls)

    @property
    def sealed(self):
        """Whether no rock crosses any wall; a free surface goes with it."""
        names = [name for name in self.walls if name != "surface" or not self.free]
        return all(self.normal_velocity(name) == 0 for name in names)


def normal_velocity(name, wall, outline):
    """Return the velocity across a wall, m/s: 0, another number, or None where it is free.

    One component held on an inclined wall does not hold u.n; free-slip does, and both components.
    Of a table it is the greatest one, by size: 0 only where no rock ever crosses.

    Args:
        name: of the wall.
        wall: `Wall`.
        outline: `Outline`.
    """
    velocity = [_greatest(value) for value in wall.velocity]
    across = velocity[normal_axis(name, len(velocity))]
    line = {"surface": outline.surface, "base": outline.base}.get(name)
    if wall.kind == "free-slip" or line is None or np.ptp(line[:, 1]) == 0:
        return across
    return None if None in velocity else max(velocity, key=abs)


def _greatest(value):
    """Return the greatest value of a table, by size; anything else as it is."""
    return max(value.span, key=abs) if isinstance(value, Table) else value

"""What is drawn of a section: rocks, lines, arrows, axes, scale bar and legend."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from restoration.lines import surface_of
from restoration.page import DPI, INK, round_number, shorten
from restoration.plan import counts_back
from restoration.scene import Outline, Scene
from restoration.units import YEAR, number

LINE_STYLES = {
    "horizon": {"color": "#111111", "linewidth": 0.9},
    "fault": {"color": "#c00020", "linewidth": 1.4},
    "edge": {"color": "#c00020", "linewidth": 0.5},
    "surface": {"color": "#111111", "linewidth": 0.9},
}
UNNAMED = {"edge", "surface"}  # kinds that the key leaves out


@dataclass(frozen=True, eq=False)
class Panel:
    """A section at one model time.

    Attributes:
        scene: what is modelled.
        time: model time, s.
        x: particle positions, shape (n, 2), m.
        unit: row of `Scene.units` of every particle, shape (n,).
        lines: horizons and faults at that time, a sequence of `restoration.scene.Line`.
        velocity: points, shape (k, 2), m, and the velocity there, shape (k, 2), m/s; or None.
        outline: the frame at that time; None for the scene's, below the surface among the lines.
        label: replaces the text of the time.
    """

    scene: Scene
    time: float
    x: np.ndarray
    unit: np.ndarray
    lines: tuple = ()
    velocity: tuple | None = None
    outline: Outline | None = None
    label: str = ""

    @property
    def frame(self):
        """The outline at that time."""
        moved = surface_of(self.lines)
        if moved is not None:
            return Outline(moved.points, self.scene.outline.base)
        return self.outline or self.scene.outline


def limits(panels):
    """Return (left, right, bottom, top) of the frames of all panels, m."""
    points = np.concatenate([[*p.frame.surface, *p.frame.base] for p in panels])
    (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
    return left, right, bottom, top


def fit(extent, exaggeration, width, height):
    """Return the pixels of the largest picture of an extent in a box of width and height."""
    left, right, bottom, top = extent
    aspect = (top - bottom) * exaggeration / (right - left)
    width = min(width, height / aspect)
    return max(round(width), 2), max(round(width * aspect), 2)


def nearest_particle(panel, extent, size):
    """Return the row of the particle nearest to every pixel, -1 outside the frame.

    Args:
        panel: the section.
        extent: left, right, bottom and top of the picture, m.
        size: its width and height, pixels.

    Returns:
        Shape (height, width), int64, the uppermost row of pixels first.
    """
    left, right, bottom, top = extent
    width, height = size
    x = left + (np.arange(width) + 0.5) * (right - left) / width
    z = top - (np.arange(height) + 0.5) * (top - bottom) / height
    surface, base = (np.interp(x, *line.T) for line in (panel.frame.surface, panel.frame.base))
    inside = (z[:, None] <= surface) & (z[:, None] >= base)
    rows, columns = np.nonzero(inside)
    nearest = np.full((height, width), -1)
    tree = cKDTree(panel.x)
    nearest[inside] = tree.query(np.column_stack([x[columns], z[rows]]))[1]
    return nearest


def paint_rocks(axes, panel, extent, size):
    """Fill the section with the colours of its units, each pixel as its nearest particle."""
    nearest = nearest_particle(panel, extent, size)
    unit = np.where(nearest < 0, -1, panel.unit[nearest])
    paint_units(axes, panel.scene, unit, extent)


def paint_units(axes, scene, unit, extent):
    """Paint an image of units, rows of `Scene.units` by pixel, -1 where there is none."""
    from matplotlib.colors import to_rgba_array

    colors = np.array([*to_rgba_array([unit.color for unit in scene.units]), [1, 1, 1, 0]])
    image = np.round(255 * colors).astype(np.uint8)[unit]
    axes.imshow(image, extent=extent, aspect="auto", interpolation="nearest", zorder=0)


def draw_lines(axes, panel):
    """Draw horizons, faults and the frame."""
    frame = np.concatenate([panel.frame.surface, panel.frame.base[::-1], panel.frame.surface[:1]])
    axes.plot(*frame.T, color=INK, linewidth=0.8, clip_on=False, zorder=3)
    for line in panel.lines:
        axes.plot(*line.points.T, **LINE_STYLES[line.kind], zorder=2, solid_capstyle="round")


def draw_arrows(axes, panel, extent, size, key):
    """Draw velocity arrows on a regular pattern; the reference arrow begins at ``key``, pixels."""
    points, u = panel.velocity
    speed = np.hypot(*u.T).max()
    if speed == 0:
        return
    left, right, bottom, top = extent
    step = max(size) / 18
    columns, rows = (max(round(n / step), 2) for n in size)
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    z = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    pattern = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    chosen = np.unique(cKDTree(points).query(pattern)[1])
    arrows = axes.quiver(
        *points[chosen].T,
        *u[chosen].T,
        angles="xy",
        units="dots",
        scale_units="dots",
        scale=speed / (1.3 * step),
        pivot="mid",
        width=3.2,
        facecolor=INK,
        edgecolor="white",
        linewidth=0.5,
        clip_on=False,
        zorder=4,
    )
    reference = round_number(speed * YEAR * 1e3)  # mm/yr
    length = reference * 1e-3 / YEAR / speed * 1.3 * step
    axes.quiverkey(
        arrows,
        (key[0] + length) / DPI,
        key[1] / DPI,
        reference * 1e-3 / YEAR,
        f"{number(reference)} mm/yr",
        coordinates="inches",
        labelpos="E",
    )


def label_axes(axes, scene, extent, x_label=True, z_label=True):
    """Write distance and depth (elevation where the surface is not at 0) in km or m."""
    left, right, bottom, top = extent
    unit, size = length_unit(extent)
    depth = np.ptp(scene.outline.surface[:, 1]) == 0 and scene.outline.surface[0, 1] == 0
    axes.set(xlim=(left, right), ylim=(bottom, top))
    sign = -1 if depth else 1
    axes.xaxis.set_major_formatter(lambda value, _: number(value / size + 0.0, 4))
    axes.yaxis.set_major_formatter(lambda value, _: number(sign * value / size + 0.0, 4))
    axes.tick_params(direction="out", length=3, labelbottom=x_label, labelleft=z_label)
    if x_label:
        axes.set_xlabel(f"Distance ({unit})")
    if z_label:
        axes.set_ylabel(f"{'Depth' if depth else 'Elevation'} ({unit})")
    for spine in axes.spines.values():
        spine.set_visible(False)


def scale_bar(page, right, bottom, scene, extent, width):
    """Draw the scale bar of a picture ``width`` pixels wide, with the vertical exaggeration."""
    unit, size = length_unit(extent)
    length = round_number((extent[1] - extent[0]) / 4)
    pixels = length / (extent[1] - extent[0]) * width
    left = right - pixels
    page.line([left, left, left, right, right, right], np.add(bottom, [10, 0, 5, 5, 10, 0]))
    ratio = scene.output.exaggeration
    ratio = "1:1" if ratio == 1 else f"\N{MULTIPLICATION SIGN} {number(ratio)}"
    text = f"V.E. {ratio}      {number(length / size)} {unit}"
    page.text(left - 12, bottom - 4, text, ha="right")


def legend_handles(panels):
    """Return the legend of the units, youngest (last of the scene) first, and of the lines."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    scene = panels[0].scene
    handles = [
        Patch(facecolor=unit.color, edgecolor=INK, linewidth=0.6, label=unit_label(scene, unit))
        for unit in reversed(scene.units)
    ]
    kinds = {line.kind for panel in panels for line in panel.lines} - UNNAMED
    return handles + [
        Line2D([], [], label=kind, **LINE_STYLES[kind]) for kind in LINE_STYLES if kind in kinds
    ]


def unit_label(scene, unit):
    """Return the name of a unit, with its rock where that has another name."""
    rock = scene.rocks[unit.rock].name
    name = unit.name if unit.name == rock else f"{unit.name} ({rock})"
    # matplotlib hides labels that begin with an underscore.
    return f"\N{HAIR SPACE}{shorten(name, 32)}"


def time_text(scene, time, before=None):
    """Return a model time in words, such as ``t = 6.00 Myr`` or ``2.00 Ma (restored)``.

    Where no mark is after today times are ages, elsewhere they count from the start. Runs that span
    less than 0.1 Myr are told in thousand years.

    Args:
        scene: whose marks tell which.
        time: model time, s.
        before: model time of the picture before, s, if there is one.
    """
    size, span, age = time_units(scene)
    from_today = counts_back(scene)
    value = f"{abs(time) / size:.2f}"
    if abs(time) < size and abs(float(value) - abs(time) / size) > 5e-4:
        value = f"{abs(time) / size:.3f}"  # three figures, where a run stopped between its marks
    value = f"-{value}" if (time < 0) != from_today and time else value
    text = f"t = {value} {span}"
    if from_today:
        text = f"{value} {age}" if time else "today"
    if before is None:
        return text
    if time < before:
        return f"{text} (restored)"
    return f"{text} (forward)" if from_today and time > before else text


def time_units(scene):
    """Return the size, s, of the unit of time that suits a run, and its names for time and age."""
    young = max(map(abs, scene.time.marks)) < 0.1e6 * YEAR
    return (1e3 * YEAR, "kyr", "ka") if young else (1e6 * YEAR, "Myr", "Ma")


def length_unit(extent):
    """Return the name and the size, m, of the unit of length that suits a picture."""
    left, right, bottom, top = extent
    return ("km", 1e3) if max(right - left, top - bottom) >= 1e3 else ("m", 1.0)

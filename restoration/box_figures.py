"""Pictures of a box in three dimensions: a cut along x through its middle, and a horizon in map."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from restoration.canvas import (
    LINE_STYLES,
    fit,
    label_axes,
    legend_handles,
    length_unit,
    paint_units,
)
from restoration.figures import LEAST, LEFT, TOP, caption, draw_histogram, paint_distance
from restoration.page import INK, Page, legend_size, shorten, style
from restoration.scene import Scene
from restoration.sheets import crossing, triangles
from restoration.units import number

DEEPEST = 1200  # pixels of a map along y
BELOW = 80  # pixels for what is written below a cut or a map
GAP, MAP_GAP, BAR = 40, 130, 22  # between columns, between cut and map, of a colour bar, pixels


@dataclass(frozen=True, eq=False)
class Shot:
    """A box at one model time.

    Attributes:
        scene: what is modelled.
        time: model time, s.
        x: particle positions, shape (n, 3), m.
        unit: row of `Scene.units` of every particle, shape (n,).
        lines: `scene.Sheet`s.
        label: the time in words.
    """

    scene: Scene
    time: float
    x: np.ndarray
    unit: np.ndarray
    lines: tuple
    label: str

    @property
    def middle(self):
        """Where the cut goes through, y in m."""
        return self.scene.length / 2

    def nearest(self, size):
        """Return the row of the particle nearest to every pixel of the cut, shape (height, width).

        Args:
            size: width and height of the picture, pixels.
        """
        left, right, bottom, top = extent_of_cut(self.scene)
        columns, rows = ((np.arange(n) + 0.5) / n for n in size)
        x, z = np.meshgrid(left + columns * (right - left), top - rows * (top - bottom))
        pixels = np.column_stack([x.ravel(), np.full(x.size, self.middle), z.ravel()])
        return cKDTree(self.x).query(pixels)[1].reshape(x.shape)


def extent_of_cut(scene):
    """Return left, right, bottom and top of a vertical cut along x, m."""
    width, _, height = scene.extent
    return 0.0, width, -height, 0.0


@style()
def draw_box(path, shots):
    """Draw a box at several times: above cuts, below maps of its horizon of most relief, as PNG.

    Args:
        path: path of the picture.
        shots: list of `Shot` of one scene.

    Raises:
        OutputError: the picture could not be written.
    """
    scene, cut = shots[0].scene, extent_of_cut(shots[0].scene)
    widest = min(1900 / len(shots), DEEPEST * scene.outline.width / scene.length)
    width, high = fit(cut, scene.output.exaggeration, widest, 700)
    chosen = _boldest(shots)
    deep = round(width * scene.length / scene.outline.width) if chosen is not None else 0
    handles = legend_handles(shots)
    legend = legend_size(handles)
    low = BELOW + 30 + (deep + MAP_GAP if deep else 0)
    wide = LEFT + len(shots) * (width + GAP)
    page = Page(max(wide + legend[0], 900), low + max(high, legend[1]) + TOP)
    page.text(LEFT, page.size[1] - 35, shorten(scene.title, 70), weight="bold", size=11)
    page.legend(handles, wide, low + high)
    span = _span([shot.lines[chosen] for shot in shots]) if deep else None
    for i, shot in enumerate(shots):
        left = LEFT + i * (width + GAP)
        _draw_cut(page.axes(left, low, width, high), shot, (width, high), i == 0)
        page.text(left, low + high + 15, shot.label + _stretched(scene) * (i == 0))
        if not deep:
            continue
        axes = page.axes(left, BELOW + 30, width, deep)
        mapped = _draw_map(axes, shot.lines[chosen], scene, span, i == 0)
        if i + 1 == len(shots):
            _depth_bar(page, (wide - GAP + 20, BELOW + 30, BAR, deep), mapped, cut)
    if deep:
        name = f"{shots[0].lines[chosen].name} from above, the cut dashed"
        page.text(LEFT, BELOW + 30 + deep + 15, name)
    page.save(path)


@style()
def draw_box_return(path, start, end, stats):
    """Draw how far everything lies from where it began, after the way there and back, as PNG.

    Args:
        path: path of the picture.
        start, end: `Shot` of the same particles and sheets at both ends; a particle that came later
            starts at NaN and is left out.
        stats: as `figures.draw_there_and_back` takes them.

    Raises:
        OutputError: the picture could not be written.
    """
    scene, cut = start.scene, extent_of_cut(start.scene)
    old = np.isfinite(start.x).all(axis=1)
    kept = Shot(scene, start.time, start.x[old], start.unit[old], start.lines, start.label)
    distance = np.maximum(np.linalg.norm(end.x[old] - kept.x, axis=1), LEAST)
    width, high = fit(cut, scene.output.exaggeration, 800, 500)
    low = 2 * BELOW + 500
    page = Page(LEFT + width + 260, low + high + TOP)
    page.text(LEFT, page.size[1] - 35, shorten(scene.title, 70), weight="bold", size=11)
    place = LEFT, low, width, high
    axes = paint_distance(page, place, distance[kept.nearest((width, high))], distance, cut)
    _draw_crossings(axes, kept)
    label_axes(axes, scene, cut)
    caption(page, place, "a", "distance of every particle from its start, at its start")
    draw_histogram(page, (LEFT, BELOW + 30, width, 360), distance, stats)
    page.save(path)


def _stretched(scene):
    """Return the vertical exaggeration of the cuts in words, nothing where there is none."""
    ratio = scene.output.exaggeration
    return "" if ratio == 1 else f"      V.E. \N{MULTIPLICATION SIGN} {number(ratio)}"


def _boldest(shots):
    """Return which sheet has the greatest relief in any shot; None where there is none."""
    relief = [[np.ptp(sheet.points[:, 2]) for sheet in shot.lines] for shot in shots]
    return int(np.max(relief, axis=0).argmax()) if relief[0] else None


def _span(sheets):
    """Return least and greatest height of sheets, m; never the same."""
    heights = np.concatenate([sheet.points[:, 2] for sheet in sheets])
    return heights.min(), max(heights.max(), heights.min() + 1)


def _draw_cut(axes, shot, size, first):
    extent = extent_of_cut(shot.scene)
    paint_units(axes, shot.scene, shot.unit[shot.nearest(size)], extent)
    _draw_crossings(axes, shot)
    left, right, bottom, top = extent
    frame = np.array([left, right, right, left, left]), [bottom, bottom, top, top, bottom]
    axes.plot(*frame, color=INK, linewidth=0.8, clip_on=False)
    label_axes(axes, shot.scene, extent, z_label=first)


def _draw_crossings(axes, shot):
    from matplotlib.collections import LineCollection

    for sheet in shot.lines:
        axes.add_collection(LineCollection(crossing(sheet, shot.middle), **LINE_STYLES[sheet.kind]))


def _draw_map(axes, sheet, scene, span, first):
    """Draw a sheet from above, what is higher on top; return what a colour bar is made of."""
    from matplotlib.collections import PolyCollection

    unit, size = length_unit(extent_of_cut(scene))
    corners = sheet.points[triangles(sheet.shape)]
    height = corners[..., 2].mean(axis=1)
    order = np.argsort(height)
    depth = -height[order] / size
    mapped = PolyCollection(corners[order][..., :2], array=depth, cmap="viridis_r")
    # without smoothed edges, which would show as a grid
    mapped.set(linewidth=0, antialiased=False, clim=(-span[1] / size, -span[0] / size))
    axes.add_collection(mapped)
    axes.axhline(scene.length / 2, color=INK, linewidth=0.8, linestyle="--")
    axes.set(xlim=(0, scene.outline.width), ylim=(0, scene.length), xlabel=f"Distance ({unit})")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: number(value / size + 0.0, 4))
    axes.tick_params(direction="out", length=3, labelleft=first)
    if first:
        axes.set_ylabel(f"Along y ({unit})")
    return mapped


def _depth_bar(page, place, mapped, extent):
    bar = page.figure.colorbar(mapped, cax=page.axes(*place))
    bar.ax.yaxis.set_major_formatter(lambda value, _: number(value + 0.0, 4))
    bar.ax.invert_yaxis()
    bar.set_label(f"Depth ({length_unit(extent)[0]})")

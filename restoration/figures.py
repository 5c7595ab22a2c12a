"""The pictures of a run: a section, the strip of all marks, the way there and back."""

from dataclasses import replace
from math import ceil

import numpy as np

from restoration.canvas import (
    Panel,
    draw_arrows,
    draw_lines,
    fit,
    label_axes,
    legend_handles,
    limits,
    nearest_particle,
    paint_rocks,
    scale_bar,
    time_text,
    time_units,
)
from restoration.page import INK, Page, legend_size, shorten, style
from restoration.plan import counts_back
from restoration.units import number

LEFT, BOTTOM, TOP, GAP = 110, 110, 90, 40  # margins around sections and the space between, pixels
LEAST = 1e-3  # m, a distance shown for none


@style()
def draw_section(path, scene, time, x, unit, lines=(), velocity=None, outline=None, label=""):
    """Draw a section as a PNG file in the colours of its units.

    Args:
        path: path of the picture.
        scene: what is modelled.
        time: model time, s.
        x: particle positions, shape (n, 2), m.
        unit: row of `Scene.units` of every particle, shape (n,).
        lines: horizons and faults at that time, a sequence of `restoration.scene.Line`.
        velocity: points, shape (k, 2), m, and the velocity there, shape (k, 2), m/s; or None.
        outline: the frame at that time; None for the scene's.
        label: replaces the text of the time.

    Raises:
        OutputError: the picture could not be written.
    """
    panel = Panel(scene, time, x, unit, tuple(lines), velocity, outline, label)
    extent = limits([panel])
    size = width, height = fit(extent, scene.output.exaggeration, 1400, 1400)
    page, bottom = _page([panel], width, height)
    axes = page.axes(LEFT, bottom, width, height)
    paint_rocks(axes, panel, extent, size)
    draw_lines(axes, panel)
    label_axes(axes, scene, extent)
    if velocity is not None:
        draw_arrows(axes, panel, extent, size, key=(LEFT, bottom - 80))
    page.text(LEFT, bottom + height + 18, label or time_text(scene, time))
    scale_bar(page, LEFT + width, bottom - 85, scene, extent, width)
    page.save(path)


@style()
def draw_strip(path, panels):
    """Draw sections at several times side by side, at one scale and with one legend, as PNG.

    Args:
        path: path of the picture.
        panels: list of `restoration.canvas.Panel`, or of tuples of its attributes, all of one
            scene and in the order of the run; drawn without arrows.

    Raises:
        OutputError: the picture could not be written.
    """
    panels = [panel if isinstance(panel, Panel) else Panel(*panel) for panel in panels]
    scene, extent, head = panels[0].scene, limits(panels), 50
    befores = [None, *(panel.time for panel in panels)]
    columns, (width, height) = _grid_of(panels, extent)
    rows = ceil(len(panels) / columns)
    whole = columns * (width + GAP) - GAP, rows * (height + head) - head
    page, bottom = _page(panels, *whole)
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        left = LEFT + column * (width + GAP)
        low = bottom + (rows - 1 - row) * (height + head)
        axes = page.axes(left, low, width, height)
        paint_rocks(axes, panel, extent, (width, height))
        draw_lines(axes, panel)
        label_axes(axes, scene, extent, i + columns >= len(panels), column == 0)
        page.text(left, low + height + 15, panel.label or time_text(scene, panel.time, befores[i]))
    scale_bar(page, LEFT + whole[0], bottom - 85, scene, extent, width)
    page.save(path)


def _page(panels, width, height):
    """Return a page with title and legend around sections of this size, and where they begin."""
    scene, handles = panels[0].scene, legend_handles(panels)
    legend = legend_size(handles)
    bottom = max(BOTTOM, legend[1] - height + 20)
    page = Page(LEFT + width + 30 + legend[0], bottom + height + TOP)
    title = shorten(scene.title, int(page.size[0] / 17))
    page.text(LEFT, bottom + height + 50, title, weight="bold", size=11)
    page.legend(handles, LEFT + width + 30, bottom + height)
    return page, bottom


def _grid_of(panels, extent):
    """Return the number of columns that gives the largest sections, and their size in pixels."""
    choices = {}
    for columns in range(1, len(panels) + 1):
        box = 1900 / columns, 1200 / ceil(len(panels) / columns)
        choices[columns] = fit(extent, panels[0].scene.output.exaggeration, *box)
    columns = max(choices, key=lambda columns: choices[columns])
    return columns, choices[columns]


@style()
def draw_flatness(path, scene, stopping):
    """Draw what a stop measured against time, as PNG.

    Args:
        path: path of the picture.
        scene: what is modelled.
        stopping: `restoration.stopping.Stopping` of a march that has ended.

    Raises:
        OutputError: the picture could not be written.
    """
    plan, back = stopping.plan, counts_back(scene)
    size, span, age = time_units(scene)
    time, value = np.array(sorted(stopping.history)).T
    page = Page(1200, 760)
    axes = page.axes(LEFT, BOTTOM, 1200 - LEFT - 60, 760 - BOTTOM - TOP)
    sign = -1 if back else 1
    axes.plot(sign * time / size, value, color=INK, linewidth=1.2, marker=".", markersize=3)
    if plan.value is not None:
        axes.axhline(plan.value, color="#9aa7b5", linewidth=0.8, linestyle="--")
    if stopping.time is not None:
        at = sign * stopping.time / size
        axes.axvline(at, color="#c00020", linewidth=0.8)
        axes.plot([at], [stopping.value], "o", color="#c00020", markersize=5)
    what = {"relief": "Relief", "depth": "Depth of the highest point"}
    axes.set(
        xlabel=f"Age ({age})" if back else f"Time ({span})",
        ylabel=f"{what.get(plan.criterion, 'Root mean square of the height')} (m)",
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda x, _: number(x + 0.0, 4))
    axes.spines[["top", "right"]].set_visible(False)
    page.text(LEFT, 760 - 40, shorten(scene.title, 70), weight="bold", size=11)
    met = "stopped at the red line" if stopping.time is not None else "not met"
    page.text(LEFT, 760 - 72, f"{shorten(plan.horizon, 50)}: {met}")
    page.save(path)


@style()
def draw_there_and_back(path, scene, start, x, unit, lines_start, lines_end, stats):
    """Draw how far everything lies from where it began, after the way there and back, as PNG.

    Args:
        path: path of the picture.
        scene: what is modelled.
        start: particle positions at the start, shape (n, 2), m; NaN for a particle that came
            later, which is left out.
        x: positions of the same particles at the end, shape (n, 2), m.
        unit: row of `Scene.units` of every particle, shape (n,).
        lines_start: horizons and faults at the start, a sequence of `restoration.scene.Line`.
        lines_end: the same ones at the end.
        stats: ``mean_m``, ``p99_m`` and ``max_m`` of the particles; ``horizons``, a list of
            ``name``, ``mean_m`` and ``max_m``, where it is known.

    Raises:
        OutputError: the picture could not be written.
    """
    old = np.isfinite(start).all(axis=1)
    start, x, unit = start[old], x[old], unit[old]
    distance = np.maximum(np.hypot(*(x - start).T), LEAST)
    panel = Panel(scene, scene.time.marks[0], start, unit, tuple(lines_start))
    extent, ratio = limits([panel]), scene.output.exaggeration
    wide = fit(extent, ratio, 1000, 1000)[1] < 500
    width, height = fit(extent, ratio, 1400, 600) if wide else fit(extent, ratio, 600, 660)
    legend = _horizon_legend(lines_end, stats.get("horizons") or [])
    legend_width, legend_height = legend_size(legend)
    step = (0, height + 150) if wide else (width + 270, 0)
    bottom = max(BOTTOM, legend_height + 20 - height - step[1])
    page = Page(LEFT + 2 * step[0] + width + 30 + legend_width, bottom + 2 * step[1] + height + TOP)
    places = [(LEFT + k * step[0], bottom + (2 - k) * step[1], width, height) for k in range(3)]
    page.text(LEFT, page.size[1] - 35, shorten(scene.title, 70), weight="bold", size=11)
    _distance_map(page, places[0], panel, extent, distance)
    draw_histogram(page, places[1], distance, stats)
    _horizons(page, places[2], panel, extent, lines_end)
    page.legend(legend, places[2][0] + width + 30, bottom + step[1] + height)
    scale_bar(page, LEFT + width, places[0][1] - 85, scene, extent, width)
    page.save(path)


def _distance_map(page, place, panel, extent, distance):
    """Draw a section coloured by the distance of every particle from its start."""
    nearest = nearest_particle(panel, extent, place[2:])
    image = np.where(nearest < 0, np.nan, distance[nearest])
    axes = paint_distance(page, place, image, distance, extent)
    draw_lines(axes, panel)
    label_axes(axes, panel.scene, extent)
    caption(page, place, "a", "distance of every particle from its start, at its start")


def paint_distance(page, place, image, distance, extent):
    """Paint an image of distances, m, with a colour bar beside it; return its axes.

    Args:
        page: `Page`.
        place: left, bottom, width and height, pixels.
        image: distance by pixel, shape (height, width), m.
        distance: of all particles, shape (n,), m, above 0: the scale.
        extent: left, right, bottom and top of the picture, m.
    """
    from matplotlib.colors import LogNorm

    left, bottom, width, height = place
    most = distance.max()
    least = min(max(np.quantile(distance, 0.02), most * 1e-3), most / 10)
    axes = page.axes(*place)
    picture = axes.imshow(
        image,
        extent=extent,
        aspect="auto",
        interpolation="nearest",
        cmap="YlOrRd",
        norm=LogNorm(least, most),
    )
    bar = page.figure.colorbar(picture, cax=page.axes(left + width + 12, bottom, 22, height))
    bar.ax.yaxis.set_major_formatter(lambda value, _: number(value))
    bar.ax.yaxis.set_minor_formatter(lambda *_: "")
    bar.set_label("Distance (m)")
    return axes


def draw_histogram(page, place, distance, stats):
    """Draw the distribution of the distances, both axes logarithmic."""
    axes = page.axes(*place)
    most = distance.max()
    edges = np.geomspace(max(distance.min(), most * 1e-5) * 0.999, most * 1.001, 41)
    axes.hist(
        np.maximum(distance, edges[0]), edges, color="#9aa7b5", edgecolor="white", linewidth=0.4
    )
    for name, color, dash in (
        ("mean", "#1b5e9e", "-"),
        ("p99", "#d08700", "--"),
        ("max", INK, ":"),
    ):
        label = f"{name} {number(stats[f'{name}_m'])} m"
        axes.axvline(max(stats[f"{name}_m"], LEAST), color=color, linestyle=dash, label=label)
    axes.set(xscale="log", yscale="log", xlabel="Distance from start (m)", ylabel="Particles")
    axes.set_ylim(0.7, None)
    axes.xaxis.set_major_formatter(lambda value, _: number(value))
    axes.yaxis.set_major_formatter(lambda value, _: number(value))
    axes.xaxis.set_minor_formatter(lambda *_: "")
    axes.legend(loc="upper left", framealpha=1, edgecolor="none")
    axes.spines[["top", "right"]].set_visible(False)
    caption(page, place, "b", f"{len(distance)} particles by their distance")


def _horizons(page, place, panel, extent, lines_end):
    """Draw the lines at the start, broad and grey, and at the end."""
    axes = page.axes(*place)
    draw_lines(axes, replace(panel, lines=()))
    for line in panel.lines:
        axes.plot(*line.points.T, color="#c4c4c4", linewidth=4, solid_capstyle="round")
    colors = _line_colors(lines_end)
    for line in lines_end:
        width = 0.5 if line.kind == "edge" else 1
        axes.plot(*line.points.T, color=colors[line.name], linewidth=width)
    label_axes(axes, panel.scene, extent)
    caption(page, place, "c", "horizons and faults at the start and at the end")


def _horizon_legend(lines_end, horizons):
    """Return the legend of the lines at the end, with their mean and greatest distance."""
    from matplotlib.lines import Line2D

    known = {entry["name"]: entry for entry in horizons}
    handles = [Line2D([], [], color="#c4c4c4", linewidth=4, label="at the start")]
    for name, color in reversed(_line_colors(lines_end).items()):
        label = f"\N{HAIR SPACE}{shorten(name, 28)}"
        if name in known:
            mean, most = (number(known[name][key]) for key in ("mean_m", "max_m"))
            label += f"\n   mean {mean} m, max {most} m"
        handles.append(Line2D([], [], color=color, linewidth=1.4, label=label))
    return handles


def _line_colors(lines):
    """Return a colour for every name, in the order of the lines."""
    import matplotlib

    names = dict.fromkeys(line.name for line in lines)
    palette = matplotlib.colormaps["tab10"].colors
    return {name: palette[k % len(palette)] for k, name in enumerate(names)}


def caption(page, place, letter, text):
    """Write a letter and a line of text above a part of a page."""
    left, bottom, _, height = place
    page.text(left, bottom + height + 15, letter, weight="bold", size=10)
    page.text(left + 22, bottom + height + 15, text)

"""The picture of a certificate: where a restoration may be off, and what was stretched."""

import numpy as np

from restoration.canvas import Panel, draw_lines, fit, label_axes, limits, nearest_particle
from restoration.displacement import deformation, matched
from restoration.page import Page, legend_size, shorten, style
from restoration.units import MYR, number

LEFT, BOTTOM, TOP, GAP = 110, 110, 110, 240  # margins around the panels and between, pixels
LEAST = 1e-2  # m, an error shown for none


@style()
def draw_certificate(path, scene, growth, certificate):
    """Draw the predicted errors of a restored section, their growth, and the stretch, as PNG.

    Args:
        path: path of the picture.
        scene: what was restored.
        growth: `companions.Growth`.
        certificate: of `certificate.certified`.

    Raises:
        OutputError: the picture could not be written.
    """
    from matplotlib.colors import LogNorm

    count = len(growth.mesh)
    given, end = growth.states[0], growth.states[count - 1]
    panels = [Panel(scene, s.time, s.particles.x, s.particles.unit, s.lines) for s in (end, given)]
    extent = limits(panels)
    width, height = fit(extent, scene.output.exaggeration, 700, 640)
    curve = 640, max(height, 400)
    series = _series(certificate)
    key = legend_size(series)
    places = [LEFT, LEFT + width + GAP, LEFT + 2 * width + 2 * GAP]
    low = BOTTOM + max(0, curve[1] - height)
    page = Page(places[2] + curve[0] + 40 + key[0], low + height + TOP)
    page.text(LEFT, page.size[1] - 35, shorten(scene.title, 70), weight="bold", size=11)
    noise = np.mean([(off[count - 1] ** 2).sum(axis=1) for off in growth.noise], axis=0)
    error = np.sqrt(noise) + np.hypot(*growth.mesh[-1].T)
    rows = matched(given.particles, end.particles)
    after = np.where(rows[:, None] >= 0, end.particles.x[rows], np.nan)
    stretch = deformation(given.particles.x, after)
    for left, panel, values, what, caption in (
        (places[0], panels[0], np.maximum(error, LEAST), "Predicted error (m)", "a  as restored"),
        (places[1], panels[1], stretch, "Stretched, times", "b  stretched on the way, as given"),
    ):
        nearest = nearest_particle(panel, extent, (width, height))
        image = np.where(nearest < 0, np.nan, values[nearest])
        norm = LogNorm(*np.maximum(np.nanpercentile(values, [2, 99.9]) * [0.99, 1.01], LEAST))
        axes = page.axes(left, low, width, height)
        picture = axes.imshow(image, extent=extent, aspect="auto", cmap="YlOrRd", norm=norm)
        draw_lines(axes, panel)
        label_axes(axes, scene, extent)
        bar = page.figure.colorbar(picture, cax=page.axes(left + width + 12, low, 22, height))
        bar.ax.yaxis.set_major_formatter(lambda value, _: number(value))
        bar.set_label(what)
        page.text(left, low + height + 18, caption)
    axes = page.axes(places[2], low + height - curve[1], *curve)
    back = np.abs(np.array(certificate["instants_s"]) - certificate["given_s"]) / MYR
    for handle, row in zip(series, _rows(certificate), strict=True):
        total = np.add(row["errors_m"]["noise"], row["errors_m"]["mesh"])
        axes.plot(back[: len(total)], np.maximum(total, LEAST), color=handle.get_color(), lw=1.4)
    axes.axhline(certificate["tolerance_m"], color="#888888", linestyle="--", lw=1)
    axes.set(yscale="log", xlabel="Time back (Myr)", ylabel="Predicted error, mean (m)")
    axes.yaxis.set_major_formatter(lambda value, _: number(value))
    axes.grid(alpha=0.3)
    page.text(places[2], low + height + 18, "c  on the way; dashed: tolerance")
    page.legend(series, places[2] + curve[0] + 30, low + height)
    page.save(path)


def _rows(certificate):
    rows = certificate["horizons"] + certificate["rocks"]
    return [row for row in rows if "errors_m" in row][:10]


def _series(certificate):
    """Return a handle of the legend for every curve."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=f"C{i % 10}", label=f"\N{HAIR SPACE}{shorten(row['name'], 24)}")
        for i, row in enumerate(_rows(certificate))
    ]

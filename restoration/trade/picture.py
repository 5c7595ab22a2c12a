"""The picture of a search: error against cost, the front a line, every point with its settings."""

import numpy as np

from restoration.page import INK, Page, shorten, style
from restoration.trade.report import compared, truth_text
from restoration.trade.trials import done, front
from restoration.units import number

WIDTH, HEIGHT = 2040, 1150  # pixels
LEFT, BOTTOM, RIGHT, TOP = 130, 110, 720, 120
FRONT, OTHER = "#c00020", "#7d8a99"
LINE, LONGEST = 27, 60  # height of a line of the key, pixels; characters of its labels


@style()
def draw_trade(path, trials, subject):
    """Draw error against CPU seconds, both logarithmic, as PNG.

    Points have numbers, which the key beside the picture explains, cheapest first.

    Args:
        path: path of the picture.
        trials: list of `trials.Trial`.
        subject: `search.Subject`.

    Raises:
        OutputError: the picture could not be written.
    """
    points = sorted(done(compared(trials)), key=lambda t: t.cpu_s)
    ahead = front(points)
    height = max(HEIGHT, TOP + BOTTOM + LINE * (len(points) + 1))
    page = Page(WIDTH, height)
    axes = page.axes(LEFT, BOTTOM, WIDTH - LEFT - RIGHT, height - BOTTOM - TOP)
    scale = 1 if subject.unit == "m" else 100
    cost, error = np.array([[t.cpu_s, max(t.error, 1e-12) * scale] for t in points]).T
    best = np.array([t in ahead for t in points])
    axes.plot(cost[best], error[best], color=FRONT, linewidth=1.4, zorder=2)
    axes.set(xscale="log", yscale="log")
    axes.set(xlim=_room(cost), ylim=_room(error))
    axes.set(
        xlabel="Cost (CPU s, one thread)",
        ylabel=f"Error, {subject.columns[0]} ({'m' if subject.unit == 'm' else '%'})",
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: number(value))
        axis.set_minor_formatter(lambda value, _: _between(value))
    axes.tick_params(which="minor", labelsize=7)
    if subject.good_to:
        axes.axhline(subject.good_to, color=OTHER, linewidth=0.8, linestyle="--", zorder=1)
    axes.grid(True, which="major", color="#e3e6ea", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.scatter(cost[~best], error[~best], 34, color=OTHER, zorder=3)
    axes.scatter(cost[best], error[best], 46, color=FRONT, zorder=4)
    _numbered(axes, cost, error, best)
    left, top = WIDTH - RIGHT + 30, height - TOP
    for i, trial in enumerate(points):
        weight = "bold" if best[i] else "normal"
        label = f"{i + 1}  {shorten(trial.label, LONGEST)}"
        page.text(left, top - LINE * (i + 1), label, size=8, weight=weight)
    page.text(LEFT, height - 45, shorten(subject.title, 95), weight="bold", size=11)
    page.text(LEFT, height - 80, shorten(truth_text(subject), 150), size=8)
    page.save(path)


def _room(values):
    """Return limits of a logarithmic axis with room around values."""
    low, high = np.log10([values.min(), values.max()])
    room = max(0.08 * (high - low), 0.12)
    return 10 ** (low - room), 10 ** (high + room)


def _between(value):
    """Return the label of a minor tick: of two and five times a power of ten."""
    return number(value) if round(value / 10 ** np.floor(np.log10(value))) in (2, 5) else ""


def _numbered(axes, cost, error, best):
    """Write the number of every point beside it, where no other point or number is."""
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    figure = axes.figure
    places = axes.transData.transform(np.column_stack([cost, error]))
    taken = [Bbox.from_bounds(x - 5, y - 5, 10, 10) for x, y in places]
    ways = [(r * np.cos(a), r * np.sin(a)) for r in (16, 24, 34, 46) for a in np.arange(8) * 0.785]
    for i, (x, y) in enumerate(places):
        text = str(i + 1)
        size = np.array([11.0 * len(text), 17.0])
        boxes = [Bbox.from_bounds(*((x + dx, y + dy) - size / 2), *size) for dx, dy in ways]
        free = [k for k, b in enumerate(boxes) if not any(b.overlaps(t) for t in taken)]
        at = free[0] if free else 0
        taken.append(boxes[at])
        middle = (boxes[at].min + boxes[at].max) / 2 / figure.bbox.size
        weight = "bold" if best[i] else "normal"
        color = FRONT if best[i] else INK
        look = {"size": 7, "color": color, "weight": weight, "ha": "center", "va": "center"}
        # A rim of white, where a line runs through.
        rim = [withStroke(linewidth=2, foreground="white")]
        figure.text(*middle, text, path_effects=rim, **look)
        if at >= 8:  # far from its point: a thin line leads there
            start = axes.transData.inverted().transform((boxes[at].min + boxes[at].max) / 2)
            axes.plot(
                [start[0], cost[i]], [start[1], error[i]], color=OTHER, linewidth=0.4, zorder=1
            )

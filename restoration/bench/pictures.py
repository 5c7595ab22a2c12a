"""A figure for every benchmark, drawn from its rows alone."""

import numpy as np

from restoration.bench import (
    certificate,
    contrasts,
    extremes,
    paper,
    peers,
    reverse_surface,
    shapes,
)
from restoration.bench.exact import two_layer_growth_rate
from restoration.bench.reference import RAMBERG, sinking_block_velocity
from restoration.page import Page, style

WIDTH, HEIGHT, LEFT, BOTTOM, TOP, GAP = 640, 520, 140, 90, 70, 150  # pixels of a panel
MARKS = "osD^v<>Pph*X"


@style()
def draw(name, rows, path):
    """Draw the figure of a benchmark as PNG.

    Args:
        name: of the benchmark.
        rows: its `rows.Row`s.
        path: path of the picture.
    """
    panels = PANELS[name](rows)
    labels = list(dict.fromkeys(label for *_, series in panels for label in series))
    key = 120 + 13 * max(map(len, labels))
    height = max(HEIGHT, 29 * len(labels))
    page = Page(LEFT + len(panels) * (WIDTH + GAP) - GAP + 30 + key, BOTTOM + height + TOP)
    handles = {}
    for i, (title, x_label, y_label, scales, series) in enumerate(panels):
        place = LEFT + i * (WIDTH + GAP), BOTTOM + height - HEIGHT, WIDTH, HEIGHT
        axes = page.axes(*place)
        axes.set(xscale=scales[0], yscale=scales[1], xlabel=x_label, ylabel=y_label, title=title)
        axes.grid(alpha=0.3)
        for label, (x, y, how) in series.items():
            handles.setdefault(label, _plot(axes, x, y, how, label, labels.index(label)))
        for axis, scale in ((axes.xaxis, scales[0]), (axes.yaxis, scales[1])):
            if scale == "log":
                _plain_ticks(axis)
        squares = sorted({int(v) for x, _, _ in series.values() for v in x})
        if x_label.startswith("squares"):
            axes.set_xticks(squares, [str(n) for n in squares])
            axes.minorticks_off()
    left = LEFT + len(panels) * (WIDTH + GAP) - GAP + 30
    page.legend([handles[label] for label in labels], left, BOTTOM + height)
    page.save(path)


def _plot(axes, x, y, how, label, number):
    """Plot a series by its number among all labels: a grey or coloured line, or marks."""
    color = f"C{number % 10}"
    if how == "line":
        (drawn,) = axes.plot(x, y, "-", color="#888888" if number == 0 else color, label=label)
        return drawn
    mark = MARKS[(number + number // 10) % len(MARKS)]
    style_of = {"marker": mark, "color": color, "ms": 4, "lw": 1, "label": label}
    (drawn,) = axes.plot(x, y, linestyle="-" if how else "none", **style_of)
    return drawn


def _plain_ticks(axis):
    """Write the ticks of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _grouped(rows, key, x, y, how="-"):
    """Return series of rows by label: key, x and y are functions of a row."""
    series = {}
    for row in rows:
        series.setdefault(key(row), ([], []))
        series[key(row)][0].append(x(row))
        series[key(row)][1].append(y(row))
    return {
        label: (np.array(xs)[np.argsort(xs)], np.array(ys)[np.argsort(xs)], how)
        for label, (xs, ys) in series.items()
    }


def _rayleigh_taylor(rows):
    crests = [row for row in rows if row.parameters.get("where") == "crest"]
    eta2 = np.geomspace(1.25e20, 2.5e23, 100)
    theory, errors = {}, {}
    for wavelength in sorted({row.parameters["wavelength"] for row in crests}, reverse=True):
        rate = [
            two_layer_growth_rate(
                2 * np.pi / wavelength,
                RAMBERG["h1"],
                RAMBERG["h2"],
                RAMBERG["eta1"],
                eta,
                RAMBERG["rho1"] - RAMBERG["rho2"],
                9.81,
            )
            for eta in eta2
        ]
        theory[f"linear theory, {wavelength / 1e3:g} km"] = (
            eta2,
            np.array(rate) * RAMBERG["amplitude"],
            "line",
        )
    points = _grouped(crests, _wave, lambda r: r.parameters["eta2"], lambda r: r.value, "")
    errors = _grouped(
        crests, _wave, lambda r: r.parameters["eta2"], lambda r: abs(100 * r.relative_error)
    )
    log = ("log", "log")
    return [
        ("velocity of the crest", "eta2, Pa s", "m/s", log, theory | points),
        ("off the exact flow at 3 km", "eta2, Pa s", "per cent (the paper: 2.5)", log, errors),
    ]


def _wave(row):
    kind = "fitted" if row.parameters["fitted"] else "particles"
    return f"{kind}, {row.parameters['wavelength'] / 1e3:g} km"


def _falling_block(rows):
    points = [row for row in rows if "contrast" in row.parameters]
    ratio = np.linspace(-8.5, 8.5, 200)
    curve = {"converged": (ratio, 9.81 * 500e3**2 * sinking_block_velocity(ratio), "line")}

    def value(row):
        return row.value if "eta2" in row.parameters else row.value * 9.81 * 500e3**2

    def key(row):
        return f"eta2 {row.parameters['eta2']:g}" if "eta2" in row.parameters else "unit block"

    def at(row):
        return row.parameters["contrast"]

    off = _grouped(points, key, at, lambda r: 100 * r.relative_error)
    linear = ("linear", "linear")
    return [
        (
            "falling block",
            "log10(eta2 / eta1)",
            "v eta2 / (rho1 - rho2), m^3/s^2",
            linear,
            curve | _grouped(points, key, at, value, ""),
        ),
        ("off the converged curve", "log10(eta2 / eta1)", "per cent", linear, off),
    ]


def _rotation(rows):
    gained = [row for row in rows if "years" in row.parameters]
    series = _grouped(
        gained,
        lambda r: r.case,
        lambda r: r.parameters["years"],
        lambda r: max(abs(r.value), 1e-12),
    )
    title = "rotation: radius gained in a turn"
    return [(title, "time step, years", "m", ("log", "log"), series)]


def _vortex(rows):
    panels = []
    for when in ("half way", "at the end"):
        some = [row for row in rows if row.metric.endswith(when) and "velocities" in row.parameters]
        series = _grouped(
            some,
            lambda r: r.case,
            lambda r: r.parameters["velocities"],
            lambda r: max(r.value, 1e-16),
        )
        panels.append((f"single vortex, {when}", "velocities", "distance", ("log", "log"), series))
    return panels


def _errors(rows):
    """Errors of all elements, and of the transfers of the usual ones by the harmonic mean."""
    panels = []
    shown = [
        row
        for row in rows
        if "transfer" not in row.parameters
        or (
            row.parameters["mean"] == "harmonic"
            and row.parameters["element"] in ("P2-P1", "Q2-Q1", "Q2-P1dg")
        )
    ]
    worst = max(row.parameters["contrast"] for row in shown)

    def key(row):
        p = row.parameters
        told = f", {p['transfer']} {p['mean']}" if "transfer" in p else ""
        return f"{p['element']}{told}, {p['place']}"

    for what in ("velocity", "pressure"):
        some = [
            row
            for row in shown
            if row.metric.startswith(f"{what} error") and row.parameters["contrast"] == worst
        ]
        series = _grouped(some, key, lambda r: r.parameters["squares"], lambda r: r.value)
        title = f"{what}, contrast {worst:g}"
        panels.append((title, "squares along a side", "relative L2 error", ("log", "log"), series))
    return panels


def _van_keken(rows):
    peaks = [row for row in rows if row.metric == "greatest v_rms"]
    panels = []
    for ratio in sorted({row.parameters["ratio"] for row in peaks}):
        series = {}
        for row in peaks:
            if row.parameters["ratio"] == ratio:
                label = f"{row.parameters['interfaces']}, {row.parameters['squares']} across"
                series[label] = (row.parameters["times"], row.parameters["speeds"], "-")
        reference = next(r.reference for r in peaks if r.parameters["ratio"] == ratio)
        span = [0, max(max(x) for x, _, _ in series.values())]
        series = {"published maximum": (span, [reference] * 2, "line")} | series
        panels.append((f"van Keken, ratio {ratio}", "time", "v_rms", ("linear", "linear"), series))
    return panels


def _hydrostatic(rows):
    panels = []
    for case in dict.fromkeys(row.parameters["case"] for row in rows):
        some = [row for row in rows if row.parameters["case"] == case]
        series = _grouped(
            some,
            lambda r: r.parameters["element"],
            lambda r: r.parameters["squares"],
            lambda r: max(r.value, 1e-18),
        )
        panels.append((case, "squares along a side", "speed / falling", ("log", "log"), series))
    return panels


def _solvers(rows):
    timed = [
        row
        for row in rows
        if row.metric == "seconds of another solve"
        and row.parameters["contrast"] == 1e6
        and not row.parameters["what"]
    ]
    counted = [row for row in rows if row.metric == "iterations of FGMRES"]

    def key(row):
        return f"{row.parameters['dim']}-D, {row.parameters['solver']}"

    def weigh(row):
        return f"{row.parameters['dim']}-D, contrast {row.parameters['contrast']:g}"

    def unknowns(row):
        return row.unknowns

    return [
        (
            "assembly and solve, structure known",
            "unknowns",
            "seconds",
            ("log", "log"),
            _grouped(timed, key, unknowns, lambda r: r.value),
        ),
        (
            "iterations to 1e-8",
            "unknowns",
            "FGMRES iterations = cycles",
            ("log", "linear"),
            _grouped(counted, weigh, unknowns, lambda r: r.value),
        ),
    ]


def _adaption(rows):
    some = [row for row in rows if "over" in row.metric]
    series = {row.metric: ([i], [row.value], "") for i, row in enumerate(some)}
    return [("adaption of a mesh", "", "ratio to a Stokes solve", ("linear", "linear"), series)]


def _relaxation(rows):
    """Heights of the hill, how far the rows are off, and the errors in time."""
    hills = [row for row in rows if "kyr" in row.parameters]
    tens = [row for row in hills if row.parameters["gravity"] == 10]
    table = _grouped(
        tens, lambda r: f"computed, {r.parameters['where']}", _kyr, lambda r: abs(r.reference), ""
    )
    lines = {
        _hill(row): (row.parameters["times"], np.abs(row.parameters["heights"]), "-")
        for row in tens
    }
    off = _grouped(hills, _hill, _kyr, lambda r: max(100 * abs(r.relative_error), 1e-4))
    ordered = [row for row in rows if "counts" in row.parameters]
    errors = {
        row.case: (row.parameters["counts"], row.parameters["errors"], "-") for row in ordered
    }
    log = ("log", "log")
    return [
        ("a hill and a trough of 7 km", "kyr", "m", ("linear", "linear"), table | lines),
        ("off the computed relaxation", "kyr", "per cent (the paper: 1.3)", ("linear", "log"), off),
        ("error at the relaxation time", "steps", "relative", log, errors),
    ]


def _hill(row):
    p = row.parameters
    return f"{p['how']}{'' if p['gravity'] == 10 else ', g = 9.81'}, {p['where']}"


def _kyr(row):
    return row.parameters["kyr"]


def _sloshing(rows):
    flat = [row for row in rows if "flat" in row.parameters]

    def key(row):
        return f"theta = {row.parameters['theta']:g}"

    def step(row):
        return row.parameters["dt"]

    factors = _grouped(flat, key, step, lambda r: r.value, "")
    factors |= _grouped(flat, lambda r: f"theory, {key(r)}", step, lambda r: r.reference)
    linear = ("linear", "linear")
    panels = [("factor of the tilt in a step", "step, years", "", linear, factors)]
    for name, title in (("tilts", "tilt above the wave"), ("heights", "top left corner")):
        some = {
            f"{row.parameters['dt']} yr, {key(row)}": (
                np.array(row.parameters["times"]) / 1e3,
                # what has left the picture tells no more
                np.where(np.abs(row.parameters[name]) < 400, row.parameters[name], np.nan),
                "-",
            )
            for row in rows
            if name in row.parameters
        }
        panels.append((title, "kyr", "m", linear, some))
    return panels


def _plume(rows):
    lines = {row.case: (row.parameters["times"], row.parameters["heights"], "-") for row in rows}
    points = _grouped(
        rows,
        lambda r: r.source.split(",")[0],
        lambda r: r.parameters["myr"],
        lambda r: r.reference,
        "",
    )
    return [("topography above a plume", "Myr", "m", ("linear", "linear"), lines | points)]


def _by_case(rows, title):
    """One point for every number: its metric across, its case as the label."""
    shown = [row for row in rows if "case" in row.parameters]
    metrics = list(dict.fromkeys(row.metric for row in shown))
    series = _grouped(
        shown,
        lambda r: r.parameters["case"],
        lambda r: 1 + metrics.index(r.metric),
        lambda r: max(abs(r.value), 1e-18),
        "",
    )
    series |= {f"{i}: {metric}": ([], [], "line") for i, metric in enumerate(metrics, 1)}
    return [(title, "number in the list", "relative", ("linear", "log"), series)]


def _volume(rows):
    return _by_case(rows, "areas")


def _topography_rest(rows):
    return _by_case(rows, "motion where nothing drives it")


def _dynamic_topography(rows):
    some = [row for row in rows if "how" in row.parameters]
    series = _grouped(
        some,
        lambda r: f"{r.parameters['element']}, {r.parameters['how']}",
        lambda r: r.parameters["squares"],
        lambda r: max(abs(r.value), 1e-12),
    )
    title = "wave of the normal stress"
    return [(title, "squares along a side", "relative error", ("log", "log"), series)]


def _two_interface(rows):
    panels = []
    for metric in ("restored amplitude of the horizon", "growth of surface noise"):
        some = [row for row in rows if row.metric == metric]
        series = _grouped(
            some,
            lambda r: r.case.split(", ")[-1],
            lambda r: r.parameters["gamma_t"],
            lambda r: min(max(abs(r.value), 1e-20), 1e60),
            "",
        )
        title, scales = f"{metric}, up to 1e60", ("log", "log")
        panels.append((title, "gamma times the duration", "", scales, series))
    return panels


def _graben(rows):
    """Return the panels of the errors of the interfaces, numbered from the salt up."""
    panels = []
    for metric in ("mean", "max"):
        chosen = [row for row in rows if row.parameters.get("metric") == metric]
        first = [row for row in chosen if row.parameters["case"] == chosen[0].parameters["case"]]
        numbers = [row.parameters["interface"] for row in first]
        series = {"paper": (numbers, [row.parameters["paper_m"] for row in first], "")}
        for case in dict.fromkeys(row.parameters["case"] for row in chosen):
            found = [row.value for row in chosen if row.parameters["case"] == case]
            series[case] = (numbers, found, "")
        title = f"{metric} error of an interface"
        panels.append((title, "interface, the surface last", "m", ("linear", "log"), series))
    series = {
        row.case.removeprefix(f"{row.parameters['case']}, "): (
            row.parameters["x_km"],
            row.parameters["rise_m"],
            "line",
        )
        for row in first
    }
    panels.append(("came back too high by", "distance, km", "m", ("linear", "linear"), series))
    return panels


PANELS = {
    "rayleigh-taylor": _rayleigh_taylor,
    "falling-block": _falling_block,
    "rotation": _rotation,
    "single-vortex": _vortex,
    "solcx": _errors,
    "solkz": _errors,
    "solvi": _errors,
    "van-keken": _van_keken,
    "hydrostatic": _hydrostatic,
    "solvers": _solvers,
    "adaption": _adaption,
    "surface-relaxation": _relaxation,
    "sloshing": _sloshing,
    "crameri-2": _plume,
    "advective-volume": _volume,
    "topography-rest": _topography_rest,
    "dynamic-topography": _dynamic_topography,
    "two-interface": _two_interface,
    "reverse-surface": reverse_surface.panels,
    "graben": _graben,
    "certificate": certificate.panels,
    "paper": paper.panels,
    "peers": peers.panels,
    "contrasts": contrasts.panels,
    "extremes": extremes.panels,
    "shapes": shapes.panels,
}

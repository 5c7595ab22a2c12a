"""The certificate of a restoration: what of it can be trusted, to how many metres, and why not.

It knows nothing of the truth. Errors of the given section and of the mesh are those that
`companions` found to grow on the way back; what they leave out - other rock, other walls, what
happened besides flow - is no part of it.
"""

import numpy as np
import shapely

from restoration.diagnostics import line_distances, summary, there_and_back
from restoration.displacement import deformation, displaced, matched
from restoration.layered import restorable
from restoration.lines import as_drawn
from restoration.plan import time_label
from restoration.surface_modes import INTEGRABLE
from restoration.units import number, show
from restoration.welds import welds

HOPELESS = 10.0  # gamma T of a surface that is integrated, from which theory alone decides
NOTED = 0.005  # share of a rock from which welds, new rock and the like are told


def certified(scene, follower, growth, finest):
    """Return the certificate of a run, as entries of its record.

    Args:
        scene: `scene.Scene`.
        follower: `companions.Follower` of the run.
        growth: `companions.Growth`.
        finest: side of the finest cell, m.
    """
    given, end = follower.states[0], follower.states[-1]
    found = welds(scene, given.lines, finest, given.particles)
    count = len(growth.mesh)
    reached = count == len(growth.states) and not growth.failure
    times = [state.time for state in growth.states[:count]]
    certificate = {
        "noise_m": scene.certificate.noise,
        "tolerance_m": scene.certificate.tolerance,
        "given_s": given.time,
        "end_s": end.time,
        "instants_s": times,
        "order": growth.order,
        "failure": growth.failure or None,
        "welds": {"thickness_m": finest, "area_m2": found.area, "share": found.share},
        "new_rock_share": _new_rock(given, end),
    }
    judge = _Judge(scene, times, reached, growth.failure, abs(given.time - end.time))
    certificate["horizons"] = _horizons(given, growth, judge)
    certificate["rocks"] = _rocks(scene, given, end, growth, found, judge)
    certificate["surface"] = _surface(scene, certificate["horizons"])
    certificate["verdict"] = _verdict(certificate)
    return certificate


class _Judge:
    """Says of a series of errors whether its end can be trusted."""

    def __init__(self, scene, times, reached, failure, way):
        self.scene, self.plan, self.times = scene, scene.certificate, times
        self.reached, self.failure, self.way = reached, failure, way

    def __call__(self, noise, mesh):
        """Return the judgement of the errors from noise and mesh at the instants, m, as a dict."""
        noise, mesh = np.array(noise), np.array(mesh)
        whole = noise + mesh
        over = np.flatnonzero(~(whole <= self.plan.tolerance))
        beyond = None
        if len(over):
            beyond = self._crossing(whole, over[0])
        elif not self.reached:
            beyond = self.times[-1]
        return {
            "from_noise_m": float(noise[-1]),
            "from_mesh_m": float(mesh[-1]),
            "predicted_m": float(whole[-1]) if self.reached else None,
            "most_on_the_way_m": float(whole.max()),
            "growth": float(noise.max() / self.plan.noise),
            "trusted": beyond is None,
            "beyond_s": beyond,
            "why": self._why(noise, mesh, beyond, over),
            "errors_m": {"noise": noise.tolist(), "mesh": mesh.tolist()},
        }

    def _crossing(self, whole, i):
        """Return when an error passes the tolerance, between two instants by its logarithm."""
        if i == 0:
            return self.times[0]
        low, high = np.log(np.maximum(whole[i - 1 : i + 1], 1e-9))
        part = (np.log(self.plan.tolerance) - low) / (high - low) if high > low else 1.0
        return float(self.times[i - 1] + part * (self.times[i] - self.times[i - 1]))

    def _why(self, noise, mesh, beyond, over):
        from_noise = f"{_m(noise[-1])} from {_m(self.plan.noise)} of noise"
        if beyond is None:
            return f"{from_noise}, {_m(mesh[-1])} from the mesh"
        if not len(over):
            return "with larger cells the restoration ends there"
        worst = (noise + mesh).argmax()
        fold = number(noise.max() / self.plan.noise, 2)
        grow = f"{_m(self.plan.noise)} of noise grows to {_m(noise[worst])}"
        if noise[worst] > mesh[worst]:
            return f"errors grow {fold}-fold: {grow}, and the mesh makes {_m(mesh[worst])}"
        return f"the mesh makes {_m(mesh[worst])} at least; {grow}"

    def sentence(self, found, what=""):
        """Return a judgement in words."""
        if found["trusted"]:
            return f"trusted to {_m(found['predicted_m'])}{what} ({found['why']})"
        return (
            f"not to be trusted beyond {time_label(self.scene, found['beyond_s'])}{what}: "
            f"{found['why']}"
        )


def _horizons(given, growth, judge):
    """Return a row for every horizon and fault, and for a free surface."""
    series = {}
    count = len(growth.mesh)
    for i, state in enumerate(growth.states[:count]):
        for key, offs in (("noise", growth.noise), ("mesh", [growth.mesh])):
            found = {}
            for off in offs:
                for row in line_distances(state.lines, displaced(state, off[i]).lines):
                    found.setdefault((row["name"], row["kind"]), []).append(row["mean_m"])
            for name, means in found.items():
                errors = series.setdefault(name, {"noise": [], "mesh": []})
                errors[key].append(float(np.sqrt(np.mean(np.square(means)))))
    rows = []
    for (name, kind), errors in series.items():
        found = judge(errors["noise"], errors["mesh"])
        overturned = overturned_share([x.points for x in given.lines if x.name == name])
        verdict = f"{kind} {name}: {judge.sentence(found)}"
        rows.append(
            {"name": name, "kind": kind, "overturned": overturned} | found | {"verdict": verdict}
        )
    return rows


def overturned_share(pieces):
    """Return the share of the length of a line that runs against its way across the section.

    Args:
        pieces: vertices of its pieces, list of (n, 2), m.
    """
    back = whole = 0.0
    for points in pieces:
        step = np.diff(points, axis=0)
        length = np.hypot(*step.T)
        way = np.sign(points[-1, 0] - points[0, 0])
        back += length[step[:, 0] * way < 0].sum()
        whole += length.sum()
    return float(back / whole) if whole else 0.0


def _rocks(scene, given, end, growth, found, judge):
    """Return a row for every rock, its welds left out of its errors."""
    of_unit = np.array([unit.rock for unit in scene.units])
    first = growth.states[0].particles
    welded = found.holds(first.x)
    rows = matched(given.particles, end.particles)
    after = np.where(rows[:, None] >= 0, end.particles.x[rows], np.nan)
    stretch = deformation(given.particles.x, after)
    tolerance, judged = scene.certificate.tolerance, []
    for r, rock in enumerate(scene.rocks):
        errors, beyond = {"noise": [], "mesh": []}, 0.0
        for i, state in enumerate(growth.states[: len(growth.mesh)]):
            p = state.particles
            at = matched(p, first)
            mine = (of_unit[p.unit] == r) & ~((at >= 0) & welded[at])
            if not mine.any():
                continue
            noise = [(off[i][mine] ** 2).sum(axis=1) for off in growth.noise]
            noise, mesh = np.sqrt(np.mean(noise, axis=0)), np.hypot(*growth.mesh[i][mine].T)
            weights = p.area[mine]
            errors["noise"].append(np.average(noise, weights=weights))
            errors["mesh"].append(np.average(mesh, weights=weights))
            beyond = float(np.average(noise + mesh > tolerance, weights=weights))
        row = {"name": rock.name, "welded": found.by_rock[rock.name]["share"]}
        row["stretch"] = _percentiles(stretch[of_unit[given.particles.unit] == r])
        if not errors["noise"]:
            verdict = f"{rock.name}: all of it is welded (thinner than {_m(found.thickness)})"
            judged.append(row | {"trusted": False, "verdict": verdict})
            continue
        found_of = judge(errors["noise"], errors["mesh"])
        what = " outside its welds" if row["welded"] > NOTED else ""
        verdict = f"{rock.name}: {judge.sentence(found_of, what)}"
        if found_of["trusted"] and beyond > NOTED:
            verdict += f"; {_percent(beyond)} of it is off by more than {_m(tolerance)}"
        if what:
            verdict += (
                f"; {_percent(row['welded'])} of its area is welded (thinner than "
                f"{_m(found.thickness)}) and cannot be restored"
            )
        judged.append(row | {"share_beyond": beyond} | found_of | {"verdict": verdict})
    return judged


def _percentiles(values):
    """Return median, 99th percentile and maximum; None of none."""
    values = values[np.isfinite(values)]
    if not len(values):
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(values, [50, 99])
    return {"p50": float(p50), "p99": float(p99), "max": float(values.max())}


def _new_rock(given, end):
    """Return the share of the restored section that the given one did not hold."""
    known = matched(end.particles, given.particles) >= 0
    inside = end.particles.inside
    area = end.particles.area
    return float(area[inside & ~known].sum() / area[inside].sum())


def _surface(scene, horizons):
    """Return the row of a free surface: what theory says of its modes; None without one."""
    if not scene.free:
        return None
    theory = restorable(scene)
    growth, reverse = theory["growth"] or 0.0, scene.surface.reverse
    row = {"gamma_T": theory["growth"], "slaved": False, "trusted": True}
    if reverse == "stabilise":
        verdict = "not to be trusted: it is damped, and none of its relief is restored"
        return row | {"trusted": False, "verdict": f"surface: {verdict}"}
    if reverse == "slave" or (reverse == "auto" and growth > INTEGRABLE):
        verdict = (
            "its fast modes are slaved: they stand as the rock below holds them, and what relief "
            "the surface had besides is not known any more"
        )
        return row | {"slaved": True, "verdict": f"surface: {verdict}"}
    if growth > HOPELESS:
        verdict = (
            f"not to be trusted: its modes are integrated backward, and errors of it grow up to "
            f"10^{growth / np.log(10):.0f}-fold (gamma T = {number(growth)})"
        )
        return row | {"trusted": False, "verdict": f"surface: {verdict}"}
    verdict = (
        f"errors of it grow {number(np.exp(growth))}-fold at most (gamma T = {number(growth)})"
    )
    return row | {"verdict": f"surface: {verdict}"}


def _verdict(certificate):
    """Return the whole in one line."""
    rows = certificate["horizons"] + certificate["rocks"]
    rows += [certificate["surface"]] if certificate["surface"] else []
    doubted = [row for row in rows if not row["trusted"]]
    if not doubted:
        most = max(row["predicted_m"] for row in rows if "predicted_m" in row)
        return f"trusted to {_m(most)} on average"
    if len(doubted) == len(rows):
        return "not to be trusted"
    return f"not to be trusted in {len(doubted)} of {len(rows)} parts"


def outside_welds(found, first, given, last):
    """Return how far what is in no weld of the given section is from where the run began.

    Args:
        found: `welds.Welds` of the given section.
        first, given, last: `State` where the run began, of the given section and at the end.

    Returns:
        Mean, 99th percentile, maximum and share of the area of the particles; and the same of the
        drawn vertices of every horizon, by name, a dict: None where lines were cut on the way.
    """
    rows = matched(last.particles, given.particles)
    kept = (rows >= 0) & ~found.holds(given.particles.x[rows])
    distance, _ = there_and_back(last.particles)
    area = last.particles.area
    share = {"share": float(area[kept].sum() / area.sum())}
    horizons, states = {}, [as_drawn(state.lines) for state in (first, given, last)]
    if len({tuple(len(line.points) for line in lines) for lines in states}) > 1:
        return summary(distance[kept & ~np.isnan(distance)]) | share, None
    for name in dict.fromkeys(line.name for line in states[0] if line.kind != "edge"):
        before, at, after = ([x.points for x in lines if x.name == name] for lines in states)
        free = ~found.holds(np.concatenate(at))
        target = shapely.MultiLineString(before)
        off = shapely.distance(shapely.points(np.concatenate(after)), target)
        horizons[name] = summary(off[free]) | {"share": float(free.mean())}
    return summary(distance[kept & ~np.isnan(distance)]) | share, horizons


def failed(scene, follower, error):
    """Return the certificate of a run that failed on its way back; None where it was not on it.

    Args:
        scene: `scene.Scene`.
        follower: `companions.Follower` of the run.
        error: what ended it.
    """
    if not follower.states or follower.done:
        return None
    last = time_label(scene, follower.states[-1].time)
    return {
        "given_s": follower.states[0].time,
        "failure": str(error),
        "verdict": f"not to be trusted: the restoration itself ends after {last}: {error}",
        "surface": _surface(scene, []),
    }


def sentences(certificate):
    """Return what a certificate says, a line for each part."""
    lines = [f"certificate: {certificate['verdict']}"]
    rows = certificate.get("horizons", []) + certificate.get("rocks", [])
    rows += [certificate["surface"]] if certificate.get("surface") else []
    lines += [f"  {row['verdict']}" for row in rows]
    if certificate.get("failure") and "horizons" in certificate:
        lines.append(f"  with larger cells: {certificate['failure']}")
    if certificate.get("new_rock_share", 0) > NOTED:
        lines.append(
            f"  {_percent(certificate['new_rock_share'])} of the restored section flowed in or was "
            "born on the way back: the given section tells nothing of it"
        )
    return lines


def report(scene, certificate):
    """Return the certificate as a page of Markdown."""
    lines = [f"# Can this restoration be trusted? {scene.title}", ""]
    lines += [f"**{certificate['verdict']}**", ""]
    lines += [f"- {line.strip()}" for line in sentences(certificate)[1:]]
    if "horizons" in certificate:
        lines += ["", "![errors and stretch](figures/certificate.png)", ""]
        lines += [
            "| part | from noise | from the mesh | growth | most on the way | trusted |",
            "|---|---|---|---|---|---|",
        ]
        for row in certificate["horizons"] + certificate["rocks"]:
            if "growth" not in row:
                continue
            lines.append(
                f"| {row['name']} | {_m(row['from_noise_m'])} | {_m(row['from_mesh_m'])} | "
                f"{number(row['growth'], 2)} | {_m(row['most_on_the_way_m'])} | "
                f"{'yes' if row['trusted'] else 'no'} |"
            )
        lines += [
            "",
            "Noise: random smooth displacements of the given section of "
            f"{_m(certificate['noise_m'])} (root mean square). Tolerance: "
            f"{_m(certificate['tolerance_m'])}, of means. Errors of other rock, other walls and of "
            "what is not flow are not seen.",
        ]
    return "\n".join(lines) + "\n"


def _m(value):
    """Return a length in words."""
    return show(float(f"{value:.2g}"), "length") if value >= 0.01 else "0.01 m"


def _percent(share):
    return f"{number(100 * share, 2)} %"

"""The command line: ``restore run|check|trade CASE``, ``restore sweep``, ``restore bench``."""

import argparse
import json
import os
import signal
import sys
import traceback
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from pathlib import Path

from restoration import __version__
from restoration.environment import (
    check_environment,
    take_early,
    use_jit_cache,
    use_matplotlib_cache,
    use_numba_cache,
)
from restoration.errors import (
    TOO_LARGE,
    CaseError,
    RestorationError,
    TooLargeError,
    out_of_memory,
)
from restoration.launch import begin_together, end_together, rank_and_size, run_on_ranks

BUG = 1  # exit code of what should not happen
MISSED = 1  # exit code where a benchmark misses a bound
DESCRIPTION = "Restore geological sections by reverse-time Stokes flow."


def main(arguments=None):
    """Run a command and return its exit code (see docs/design.md).

    Of several ranks the first speaks for all.
    """
    rank, size = rank_and_size()
    with ExitStack() as streams:
        if rank > 0:
            nothing = streams.enter_context(open(os.devnull, "w"))
            streams.enter_context(redirect_stdout(nothing))
            with redirect_stderr(nothing):
                options = _parser().parse_args(arguments)
        else:
            options = _parser().parse_args(arguments)
        return _commanded(options, rank, size)


def _commanded(options, rank, size):
    """Run a command on one of several ranks, or alone, and return its exit code."""
    try:
        if size > 1:
            begin_together()
            _only_runs(options)
        for warning in check_environment():
            if rank == 0:
                print(f"warning: {warning}", file=sys.stderr)
        use_numba_cache()
        use_matplotlib_cache()
        code = options.command(options)
        sys.stdout.flush()
        return code
    except (RestorationError, KeyboardInterrupt, MemoryError, OSError) as error:
        code, text = _told(error)
    except Exception as error:
        if out_of_memory(error):
            code, text = _told(error)
        elif size == 1:
            raise
        else:
            code, text = BUG, "".join(traceback.format_exception(error))
    if text and rank == 0:
        print(text, file=sys.stderr, flush=True)
    if size > 1:
        end_together(code, text if rank else None)
    return code


def _only_runs(options):
    """Refuse on several ranks what is made for one."""
    if options.command not in (_run,):
        raise CaseError("of several ranks there can only be a run; start this without a launcher")


def _told(error):
    """Return the exit code of an error, and what to tell of it."""
    if out_of_memory(error):
        told = isinstance(error, TooLargeError)
        return TooLargeError.exit_code, str(error) if told else TOO_LARGE
    match error:
        case RestorationError():
            return error.exit_code, str(error)
        case KeyboardInterrupt():
            return 130, "stopped at once"
        case BrokenPipeError():  # the reader of our output has gone: `restore check ... | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1, ""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is not flushed yet
    return 5, f"{error.filename or 'output'}: {error.strerror}"


def _parser():
    parser = argparse.ArgumentParser("restore", description=DESCRIPTION, allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"restore {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="run a case and write its run folder")
    run.set_defaults(command=_run)
    check = commands.add_parser("check", help="tell what a case would solve, or list a section")
    check.set_defaults(command=_check)
    trade = commands.add_parser("trade", help="measure what accuracy costs, by settings")
    trade.set_defaults(command=_trade)
    trade.add_argument("case", metavar="CASE-or-BENCH", help="case file, or name of a benchmark")
    sweep = commands.add_parser("sweep", help="run a case many times with varied entries")
    sweep.set_defaults(command=_sweep)
    sweep.add_argument("sweep", metavar="SWEEP", help="sweep file, YAML: docs/sweep.md")
    for command in (run, check):
        command.add_argument("case", metavar="CASE", help="case file, YAML")
    for command in (run, check, trade, sweep):
        command.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="a.b=value",
            help="replace an entry, such as time.scheme=midpoint; may be repeated",
        )
        command.add_argument(
            "--allow-outside",
            action="store_true",
            help="let the case name files outside its own folder",
        )
    bench = commands.add_parser("bench", help="run analytic and published benchmarks")
    bench.set_defaults(command=_bench)
    bench.add_argument("names", nargs="*", metavar="NAME", help="benchmarks; default all")
    bench.add_argument("--quick", action="store_true", help="coarser and fewer, minutes")
    bench.add_argument("--json", action="store_true", help="print JSON and nothing else")
    bench.add_argument("--list", action="store_true", help="list the benchmarks")
    bench.add_argument("--out", metavar="DIR", help="write rows and a figure of each there")
    trade.add_argument("--quick", action="store_true", help="few settings")
    trade.add_argument("--json", action="store_true", help="print JSON")
    trade.add_argument("--out", metavar="DIR", help="write JSON and the Pareto plot there")
    sweep.add_argument("--workers", type=int, metavar="N", help="runs at a time; default: cores")
    sweep.add_argument("--out", metavar="DIR", help="folder of the sweep; default runs/<sweep>")
    sweep.add_argument("--list", action="store_true", help="tell what would be run, run nothing")
    sweep.add_argument("--json", action="store_true", help="print JSON")
    sweep.add_argument("--quiet", action="store_true", help="no word of single runs")
    check.add_argument("--json", action="store_true", help="print JSON")
    check.add_argument(
        "--forecast",
        action="store_true",
        help="rehearse the run on coarse cells, and tell how long it will take and the memory",
    )
    run.add_argument("--out", metavar="DIR", help="run folder; default runs/<case>-<hash8>")
    run.add_argument("--fresh", action="store_true", help="throw an earlier run away")
    run.add_argument(
        "--prove",
        action="store_true",
        help="go forward again from what was restored, on another mesh, and compare",
    )
    run.add_argument(
        "--checkpoint",
        default="auto",
        metavar="auto|off|N",
        help="write checkpoints often, at small cost; never; or every N steps",
    )
    run.add_argument(
        "--walltime",
        metavar="TIME",
        help="stop in time to have ended after, such as 23 h or 23:30:00; the same command goes on",
    )
    run.add_argument("--quiet", action="store_true", help="no progress")
    run.add_argument(
        "--ranks", type=int, metavar="N", help="share the work among N processes of this machine"
    )
    return parser


def _load(options):
    from restoration.resolve import load

    return load(options.case, tuple(options.set), options.allow_outside)


def _check(options):
    if Path(options.case).suffix.lower() in (".geojson", ".json"):
        from restoration.starter import survey_text

        print(survey_text(options.case))
        return 0
    from restoration.check import describe, describe_text

    loaded, told = _load(options), None
    if options.forecast:
        from restoration.forecast import forecast

        use_jit_cache()
        told = forecast(loaded.scene)
        _let_pipes_break()
    if options.json:
        print(json.dumps(describe(loaded, told), indent=1, allow_nan=False))
    else:
        print(describe_text(loaded, told))
    return 0


def _refuse_length(options, loaded, what):
    """Refuse an option that has no use for three dimensions yet."""
    if loaded.scene.dim == 3:
        raise CaseError(
            f"{options.case}: {what} is not possible in three dimensions (section.box.length) yet; "
            "leave it out"
        )


def _let_pipes_break():
    """Take back from PETSc what becomes of output that nobody reads, see `main`."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def _run(options):
    if Path(options.case).suffix.lower() in (".geojson", ".json"):
        raise CaseError(
            f"{options.case}: is a section, not a case; `restore check {options.case}` prints a "
            "case to start from"
        )
    if options.ranks is not None and options.ranks != 1:
        return run_on_ranks(options.ranks, _without_ranks(options))
    from restoration.keeper import age, how_often, wall_time
    from restoration.progress import Progress
    from restoration.run import run_job
    from restoration.run_folder import Job
    from restoration.stop_request import StopRequest

    checkpoint = how_often(options.checkpoint)
    walltime = None if options.walltime is None else wall_time(options.walltime)

    with StopRequest() as stop:  # already here: a Ctrl-C while a library loads would break it
        loaded = _load(options)
        if options.prove:
            _refuse_length(options, loaded, "--prove")
        for note in loaded.scene.notes if rank_and_size()[0] == 0 else ():
            print(f"note: {note}", file=sys.stderr)
        use_jit_cache()
        take_early()
        path = Path(options.case).absolute()
        job = Job(
            path,
            loaded.text,
            loaded.resolved,
            loaded.scene,
            options.out,
            options.fresh,
            options.prove,
            checkpoint,
            None if walltime is None else walltime - age(),
        )
        record, folder = run_job(job, None if options.quiet else Progress(), stop)
    if record is None:
        print(f"{folder} holds this very run, and it ended well; --fresh runs it again")
    else:
        print(summary(record, folder))
    return 0


def _without_ranks(options):
    """Return the arguments of a run but for ``--ranks``."""
    arguments = ["run", options.case, *(part for one in options.set for part in ("--set", one))]
    for name in ("out", "checkpoint", "walltime"):
        given = getattr(options, name)
        arguments += [f"--{name}", given] if given is not None else []
    flags = ("fresh", "prove", "quiet", "allow_outside")
    return arguments + [f"--{n.replace('_', '-')}" for n in flags if getattr(options, n)]


def _bench(options):
    use_jit_cache()
    from restoration.bench import suite

    names = suite.chosen(options.names)
    if options.list:
        for name in names:
            print(f"{name:<16} {suite.BENCHMARKS[name].__doc__.splitlines()[0]}")
        return 0

    def tell(text):
        print(text, flush=True)

    rows = suite.run_benchmarks(names, options.quick, options.out, None if options.json else tell)
    if options.json:
        print(json.dumps([row.plain() for row in rows], indent=1, allow_nan=False))
    else:
        print(suite.verdict(rows))
    return 0 if all(row.held is not False for row in rows) else MISSED


def _trade(options):
    from restoration.trade.command import trade

    _let_pipes_break()
    return trade(
        options.case,
        tuple(options.set),
        options.allow_outside,
        options.quick,
        options.out,
        options.json,
    )


def _sweep(options):
    from restoration.sweep.command import sweep

    return sweep(
        options.sweep,
        tuple(options.set),
        options.allow_outside,
        options.out,
        options.workers,
        options.list,
        options.json,
        options.quiet,
    )


def summary(record, folder):
    """Return what a run has to say at its end, in a few lines."""
    lines = [
        f"{record['steps']} steps, {record['stokes_solves']} Stokes solves, "
        f"{record['wall_s']:.0f} s; particles lost: {record['particles_lost']}"
    ]
    if record.get("stopped"):
        lines.append(f"stop: {record['stopped']['verdict']}")
    back = record.get("there_and_back")
    if back:
        lines.append(
            f"there and back: particles {back['mean_m']:.2f} m on average, p99 "
            f"{back['p99_m']:.2f} m, at most {back['max_m']:.2f} m"
        )
        lines += [
            f"  {row['name']}: {row['mean_m']:.2f} m on average, at most {row['max_m']:.2f} m"
            for row in record["horizons"]
        ]
        lines.append(
            "  (one scheme against itself: this measures reversibility, not the truth of a section)"
        )
    lines.append(f"pictures: {folder / 'figures'}")
    lines.append(f"for ParaView: {folder / 'fields.xdmf'}, {folder / 'particles.xdmf'}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

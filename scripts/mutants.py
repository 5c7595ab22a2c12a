"""Mutation scores: how many small faults of a module its fast tests find.

    .venv/bin/python scripts/mutants.py [MODULE ...] [--most N] [--time SECONDS]

Every mutant is a module of `restoration` with one fault: a comparison that is negated or shifted by
its boundary, `and` for `or`, a condition or a sign turned, a number that is another, a call, a
`raise` or an assignment to an attribute left out, nothing returned. It is made in memory and lives
in a fork that runs the tests, so no file is ever changed and dolfinx is loaded once. Known tools
would write each one to disk and load everything anew, leave the numbers of modules alone, which are
the limits here, or count every change of a message.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.machinery
import importlib.util
import os
import random
import signal
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEAST = 0.8  # of the mutants that are to be found
SEED = 1
PATIENCE = 5  # times as long as the tests take of the module as it is, and not less than 10 s
UNIT = "tests/restoration/test_"
# The tests that guard a module; arguments of pytest.
TESTS = {
    "checkpoint": [f"{UNIT}checkpoint.py"],
    "keeper": [f"{UNIT}keeper.py"],
    "retry": [f"{UNIT}retry.py"],
    "guards": [f"{UNIT}guards.py", f"{UNIT}guard.py"],
    "acceptance": [f"{UNIT}acceptance.py"],
    "files": [f"{UNIT}files.py"],
    "tree": [f"{UNIT}tree.py", "tests/test_broken.py", "-m", "not slow"],
    "units": [f"{UNIT}units.py"],
    "series_reader": [f"{UNIT}series_reader.py"],
    "apart": [f"{UNIT}apart.py"],
    "geojson": [f"{UNIT}section.py", "tests/test_broken.py", "-m", "not slow"],
    "run_folder": [f"{UNIT}run.py"],
}

OTHER_COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OTHER_OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.USub: ast.UAdd,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Break: ast.Continue,
    ast.Continue: ast.Break,
}


def changes(node):
    """Yield what may stand in the place of a node of a syntax tree."""
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            for other in OTHER_COMPARISONS[type(operator)]:
                yield _with(node, ops=[*node.ops[:at], other(), *node.ops[at + 1 :]])
    elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in OTHER_OPERATORS:
        yield _with(node, op=OTHER_OPERATORS[type(node.op)]())
    elif isinstance(node, ast.UnaryOp):
        if isinstance(node.op, (ast.Not, ast.USub, ast.Invert)):
            yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        more = node.value + 1 if isinstance(node.value, int) else 2 * node.value or 1.0
        yield ast.Constant(more)
    elif isinstance(node, (ast.If, ast.While, ast.IfExp)):
        if not isinstance(node.test, (ast.Compare, ast.UnaryOp)):  # these have mutants of their own
            yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, (ast.Raise, ast.AugAssign)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield ast.Pass()
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute):
        yield ast.Pass()
    elif isinstance(node, ast.Return) and not (
        node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None)
    ):
        yield ast.Return(ast.Constant(None))
    elif isinstance(node, (ast.Break, ast.Continue)):
        yield OTHER_OPERATORS[type(node)]()


def _with(node, **fields):
    made = copy.copy(node)
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def mutants(tree):
    """Return all mutants of a module: (line, what was, what is, how to put it in and out)."""
    found = []
    for node in ast.walk(tree):
        for name, value in ast.iter_fields(node):
            for at, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST):
                    for other in changes(child):
                        line = getattr(child, "lineno", 0)
                        ast.fix_missing_locations(ast.copy_location(other, child))
                        found.append((line, _text(child), _text(other), (node, name, at, other)))
    return sorted(found, key=lambda mutant: mutant[0])


def _text(node):
    lines = ast.unparse(node).splitlines()
    return lines[0] if lines else type(node).__name__


class Mutated(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Finds one module, and loads a syntax tree in its place."""

    def __init__(self, name, path, tree):
        super().__init__(name, str(path))
        self.tree = tree

    def find_spec(self, name, path=None, target=None):
        """Return the spec of the module, None of any other."""
        if name == self.name:
            return importlib.util.spec_from_file_location(name, self.path, loader=self)
        return None

    def get_code(self, name):
        """Return the code of the tree; the cache of compiled files stays out of it."""
        return compile(self.tree, self.path, "exec")


def tried(name, path, tree, arguments, seconds, told=False):
    """Return the exit code of pytest on a tree, run in a fork; None where it took too long."""
    child = os.fork()
    if child == 0:
        os.setsid()
        if not told:
            nowhere = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1, 2):
                os.dup2(nowhere, number)
        code = 70
        try:
            import pytest

            sys.meta_path.insert(0, Mutated(name, path, tree))
            code = int(pytest.main([*arguments, "-x", "-q", "-p", "no:cacheprovider"]))
        finally:
            os._exit(code)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def warm():
    """Load what all tests load but the packages of this project, whose modules are mutated."""
    from restoration.environment import use_numba_cache

    use_numba_cache()
    for name in ("dolfinx", "h5py", "numba", "pydantic", "pytest", "ruamel.yaml", "shapely"):
        importlib.import_module(name)
    for name in [name for name in sys.modules if name.split(".")[0] == "restoration"]:
        del sys.modules[name]


def score(module, most, end):
    """Try the mutants of a module, print those that no test finds, and return (found, tried)."""
    name, path = f"restoration.{module}", ROOT / "restoration" / f"{module}.py"
    tree, arguments = ast.parse(path.read_text(encoding="utf-8")), TESTS[module]
    begin = time.monotonic()
    code = tried(name, path, tree, arguments, 600, told=True)
    if code != 0:
        sys.exit(f"{module}: its tests fail as it is: pytest {' '.join(arguments)}: {code}")
    patience = max(10, PATIENCE * (time.monotonic() - begin))
    every = mutants(tree)
    chosen = sorted(random.Random(SEED).sample(range(len(every)), min(most, len(every))))
    killed = made = 0
    for line, before, after, (node, field, at, other) in (every[i] for i in chosen):
        if time.monotonic() > end:
            print(f"{module}: no time for {len(chosen) - made} of its mutants", flush=True)
            break
        kept = getattr(node, field)
        setattr(node, field, other if at is None else [*kept[:at], other, *kept[at + 1 :]])
        code = tried(name, path, tree, arguments, patience)
        setattr(node, field, kept)
        made, killed = made + 1, killed + (code != 0)
        if code == 0:
            print(f"{path.relative_to(ROOT)}:{line}: {before}  ->  {after}", flush=True)
    print(f"{module}: {killed} of {made} found, {killed / max(made, 1):.0%}", flush=True)
    return killed, made


def main():
    """Return 1 where too many mutants of a module are not found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=f"of {', '.join(TESTS)}")
    parser.add_argument("--most", type=int, default=60, help="mutants of a module, chosen once")
    parser.add_argument("--time", type=float, default=1e9, help="s, after which no other is begun")
    options = parser.parse_args()
    if unknown := set(options.modules) - set(TESTS):
        parser.error(f"no tests are known of {', '.join(sorted(unknown))}")
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    warm()
    end = time.monotonic() + options.time
    scores = {module: score(module, options.most, end) for module in options.modules or TESTS}
    print(f"\n{'module':<16}{'mutants':>8}{'found':>8}{'score':>8}")
    for module, (killed, made) in scores.items():
        print(f"{module:<16}{made:>8}{killed:>8}{killed / max(made, 1):>8.0%}")
    return int(any(killed < LEAST * made or not made for killed, made in scores.values()))


if __name__ == "__main__":
    sys.exit(main())

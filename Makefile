# The two commands that matter: `make demo` and `make test`. Each sets everything up first, and
# does so only once. Lines call `.venv/bin/python -m ...` where they can: it works in any folder.
PYTHON = .venv/bin/python
DEMO = cases/diapir-isoviscous/case.yaml

help:
	@echo "make demo   set up, run the demo case, say where the pictures are"
	@echo "make test   set up, run all tests on all cores; choose with ARGS, such as ARGS='-m \"not slow\"'"
	@echo "make setup  set up: Debian packages, .venv"
	@echo "make torture  set up, the tests of reliability with all their kills, faults and attacks: a night"
	@echo "make coverage  set up, all tests, what share of lines and branches they run; choose with ARGS"
	@echo "make mutants  set up, how many small faults of guards, input and checkpoints tests find: an hour"
	@echo "make profile  set up, say where a diapir, a graben and a 3-D run spend their time"
	@echo "make trade  set up, measure the fronts of docs/trade.md anew: half an hour; choose with ARGS"
	@echo "make limits  set up, measure docs/limits.md anew, where it holds: some minutes; choose with ARGS"
	@echo "make lint   set up, check the style"
	@echo "make clean  remove .venv, caches and built files; runs/ stays"

setup:
	@scripts/setup

demo: setup
	.venv/bin/restore run $(DEMO) --fresh

test: setup
	$(PYTHON) -m pytest -n auto --dist worksteal $(ARGS)

torture: setup
	TORTURE=1 $(PYTHON) -m pytest -n auto --dist worksteal -m torture $(ARGS)

# Tests that watch the clock may fail here, where all is slower: `make test` tells of failures.
coverage: setup
	rm -rf build/coverage && mkdir -p build/coverage
	-$(PYTHON) -m coverage run -m pytest -n auto --dist worksteal $(ARGS)
	$(PYTHON) scripts/covered.py

mutants: setup
	$(PYTHON) scripts/mutants.py $(ARGS)

profile: setup
	$(PYTHON) docs/performance.py profile

trade: setup
	$(PYTHON) docs/trade.py $(ARGS)

limits: setup
	$(PYTHON) docs/limits.py $(ARGS)

lint: setup
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

clean:
	rm -rf .venv build *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

.PHONY: help setup demo test torture coverage mutants profile trade limits lint clean

# Python 3.11 on Linux x86-64 installs without a compiler. Elsewhere PyBullet is compiled, which takes ten minutes or more
# and needs a C++ compiler and Python's headers: `apt install g++ python3-dev`, or `xcode-select --install` on macOS.
# Every target first sets up what it needs; the stamp file marks a virtual environment with the pinned packages.
PYTHON ?= $(shell python3.11 -c '' 2>/dev/null && echo python3.11 || echo python3)
PYTHON312 ?= python3.12
BIN := .venv/bin
STAMP := .venv/.installed

# Workers share the cores; threads inside a worker would only compete for them.
export OMP_NUM_THREADS := 1

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-lerobot check docs bench clean

help: ## Print this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(STAMP) ## Run `dynaforge forge` on the Can task; pass options as ARGS="--budget 5m"
	$(BIN)/dynaforge forge --task can $(ARGS)

test: $(STAMP) ## Run the default test suite (under three minutes on two cores)
	$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

test-slow: $(STAMP) ## Run the tests that take longer
	$(BIN)/python -m pytest -n 2 -m slow --timeout 1800 $(ARGS)

test-lerobot: $(STAMP) ## Read exports with LeRobot 0.4.4 and the newest, each in its own environment (large downloads)
	@test -x .venv-lerobot/bin/python || $(PYTHON) -m venv .venv-lerobot
	.venv-lerobot/bin/python -m pip install --disable-pip-version-check lerobot==0.4.4
	@if $(PYTHON312) -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then \
		{ test -x .venv-lerobot-newest/bin/python || $(PYTHON312) -m venv .venv-lerobot-newest; } && \
		.venv-lerobot-newest/bin/python -m pip install --disable-pip-version-check --upgrade 'lerobot[dataset]'; \
	else echo "make: no '$(PYTHON312)', which the newest LeRobot needs, so its test is skipped; name one: make test-lerobot PYTHON312=/path/to/python3.12"; fi
	LEROBOT_PYTHON=.venv-lerobot/bin/python LEROBOT_NEWEST_PYTHON=$$(ls .venv-lerobot-newest/bin/python 2>/dev/null) \
		$(BIN)/python -m pytest -rs -m slow tests/demos/exporters/test_lerobot_reader.py

check: $(STAMP) ## Check lint, formatting, types and the direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(STAMP) ## Build the API reference from the docstrings into build/docs; warnings are errors
	$(BIN)/python docs/build_api.py build/docs

bench: $(STAMP) ## Measure speed against the bare simulator
	$(BIN)/dynaforge bench $(ARGS)

clean: ## Remove the virtual environment, builds and caches, but no results, runs, logs or data
	rm -rf .venv build dist dynaforge.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find dynaforge assets zoo_configs tests examples -name __pycache__ -type d -prune -exec rm -rf {} +

# An existing environment is kept if its pip works; an interrupted install leaves no stamp and is resumed.
$(STAMP): setup.cfg pyproject.toml constraints.txt Makefile
	@command -v $(PYTHON) >/dev/null || { echo "make: no '$(PYTHON)' found; install Python 3.11 or newer, or name one: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(None if v >= (3, 11) else f"make: $(PYTHON) is Python {v[0]}.{v[1]}, but dynaforge needs 3.11 or newer; name one: make PYTHON=python3.11")'
	@$(PYTHON) -c 'import platform as p, sys; sys.exit((sys.version_info[:2], p.system(), p.machine()) != ((3, 11), "Linux", "x86_64"))' || command -v c++ >/dev/null || { echo "make: PyBullet is compiled for this Python, and there is no C++ compiler: name a Python 3.11 (make PYTHON=python3.11), or install one with Python's headers (apt install g++ python3-dev)" >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e ".[zoo,report,data,viser,docs,dev]"
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt --no-deps robomimic termcolor  # its reader, not its vision models
	@touch $(STAMP)

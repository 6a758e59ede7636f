PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-slow bench accuracy stability docs-pictures lint clean

## demo: cut the liver, train the baseline for three minutes, compare it with the scripts; results in runs/demo/
demo: $(VENV)/.installed
	$(BIN)/python -m agents demo --out runs/demo

## test: everything that is checked on each change
test: $(VENV)/.installed lint
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal --durations 5

## test-slow: what takes longer, such as the trained baseline's figures and the long stability runs
test-slow: $(VENV)/.installed
	$(BIN)/python -m pytest -m slow

## bench: measure every figure of docs/speed.md on this machine, peers included; takes a quarter of an hour
bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[dev,bench]"
	$(BIN)/python -m tests.benchmarks.speed --publish

## accuracy: measure error against time, and all else in docs/accuracy.md; takes a quarter of an hour, and goes on where it stopped
accuracy: $(VENV)/.installed
	$(BIN)/python -m tests.benchmarks.accuracy --publish

## stability: put every scheme through the hard cases of docs/stability.md; takes five minutes
stability: $(VENV)/.installed
	$(BIN)/python -m tests.stability

## docs-pictures: make the pictures of README and docs/ that show bodies and the map; the film shows the policy of the demo
docs-pictures: $(VENV)/.installed
	test -f runs/demo/training/best.zip || $(MAKE) demo
	$(BIN)/python -m agents.pictures runs/demo/training/best.zip

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/mypy

$(VENV)/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) runs dist build .pytest_cache .mypy_cache .ruff_cache

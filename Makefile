# `make demo` and `make test` set up .venv/ by themselves.
PYTHON ?= python3
VENV := .venv
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help install demo test lint clean

help:
	@echo 'make demo     install, simulate a small furnished building, run the program on it, say how to look at the result'
	@echo 'make test     install, then ruff, mypy --strict and pytest'
	@echo 'make install  set up $(VENV)/ only, and compile what runs need; the command is then $(VENV)/bin/ffmap'
	@echo 'make clean    remove $(VENV)/, build/, demo/ and caches (runs/ stays)'

install: $(READY)

$(READY): requirements.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("furniture-free-mapping needs Python 3.11 or newer; this is " + sys.version.split()[0] + ". Name another: make PYTHON=python3.12 ...") if sys.version_info < (3, 11) else 0'
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo 'Python has no venv module here. Install it and try again: apt-get install python3-venv'; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --requirement requirements.txt
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps ouster-sdk==1.0.1 # asks for older rosbags than ours, and reads packets without
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@echo 'compiling what runs need, by a short run that is thrown away'
	@warm=$$(mktemp -d) && export FFMAP_CACHE=$$warm && \
		$(VENV)/bin/ffmap simulate $$warm/drive.bag --seed 1 --duration 4 --quiet && \
		$(VENV)/bin/ffmap run $$warm/drive.bag --out $$warm/run --quiet && rm -r $$warm
	@touch $(READY)

demo: install
	$(VENV)/bin/ffmap demo

test: lint
	$(VENV)/bin/python -m pytest -n auto --dist loadfile

lint: install
	$(VENV)/bin/ruff check .
	@mkdir -p .types && ln -sfn .. .types/ffmap # mypy finds the package under the name that it is installed by
	$(VENV)/bin/mypy

clean:
	rm -rf $(VENV) build demo .hypothesis .pytest_cache .mypy_cache .ruff_cache .types *.egg-info

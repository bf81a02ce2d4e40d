# Two commands on a fresh machine: `make test` and `make demo`. Both make the environments they need.
PYTHON ?= $(shell for p in python3.11 python3.13 python3.12 python3; do command -v $$p >/dev/null && $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' && echo $$p && break; done)
VENV := .venv
BPY := .venv-bpy
DOCS := .venv-docs
RUN := $(VENV)/bin/python
DEMO ?= demo
# 15,000 modules are installed and a tenth of them imported; those are compiled when they are.
INSTALL := -m pip install -q --no-compile
# One process a core, each with one thread for torch. Neighbouring tests share results that are dear to make, so each
# process begins with a whole stretch of them and takes from the others' when it is done.
PARALLEL := --numprocesses auto --maxprocesses 8 --dist worksteal
# What waits for nothing else runs beside it: environments, kernels, style and types, tests of the engine and the add-on.
MAKEFLAGS += --jobs=4

.PHONY: env env-blender kernels readers test test-engine test-addon lint demo docs extension test-window clean

env: $(VENV)/.ready
env-blender: $(BPY)/.ready

$(VENV)/.ready: constraints.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed; install it and try again."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) $(INSTALL) -c constraints.txt torch==2.13.0 setuptools wheel ziglang
	$(RUN) $(INSTALL) -c constraints.txt --no-build-isolation -e ".[dev,survey,models,town]"
	@touch $@

$(BPY)/.ready: constraints-blender.txt
	$(PYTHON) -m venv $(BPY)
	$(BPY)/bin/python $(INSTALL) -r constraints-blender.txt
	@touch $@

kernels: $(VENV)/.ready
	$(RUN) -m mgf_engine.native.build

# What tests read GLB and IFC with, where npm and its registry are there; without it they say what they skip.
readers:
	npm install --no-save --no-audit --no-fund --ignore-scripts gltf-validator@2.0.0-dev.3.10 web-ifc@0.0.78

lint: $(VENV)/.ready
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m mypy

test test-engine test-addon: export OMP_NUM_THREADS := 1
test: lint test-engine test-addon

test-engine: $(VENV)/.ready kernels
	$(RUN) -m pytest $(PARALLEL) tests

# One process: beside the engine's tests it is done long before them, on two cores as on eight.
test-addon: $(VENV)/.ready $(BPY)/.ready kernels
	$(BPY)/bin/python -m pytest tests/blender

demo: $(VENV)/.ready $(BPY)/.ready kernels
	$(RUN) tools/demo.py --blender-python $(BPY)/bin/python --out $(DEMO) $(if $(SCENE),--scene "$(SCENE)") $(if $(PROMPTS),--prompts "$(PROMPTS)") $(ARGS)

$(DOCS)/.ready: constraints-docs.txt
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python $(INSTALL) -c constraints-docs.txt mkdocs-material mkdocstrings-python ruff
	@touch $@

docs: $(DOCS)/.ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/python -m mkdocs build --strict

extension: $(VENV)/.ready $(BPY)/.ready
	$(BPY)/bin/python tools/build_extension.py --engine-python $(RUN)

test-window: extension
	PYTHONPATH=tests:tests/blender $(RUN) tests/blender/window/undo.py --blender "$(or $(BLENDER),blender)" --out build/window-undo
	PYTHONPATH=tests:tests/blender $(RUN) tests/blender/window/marks.py --blender "$(or $(BLENDER),blender)" --out build/window-marks
	PYTHONPATH=tests:tests/blender $(RUN) tests/blender/window/faults.py --blender "$(or $(BLENDER),blender)" --engine "$(or $(ENGINE),$(RUN))" \
		--scene "$(SCENE)" --out build/window-faults
	PYTHONPATH=tests:tests/blender $(RUN) tests/blender/window/photos.py --blender "$(or $(BLENDER),blender)" \
		--engine "$(or $(ENGINE),$(RUN))" --scene "$(SCENE)" --out build/window-photos
	$(RUN) tests/blender/window/run.py --blender "$(or $(BLENDER),blender)" --zip dist/mgf-*.zip --scene "$(SCENE)" \
		--out build/window $(if $(WHEELS),--wheels "$(WHEELS)",--engine "$(or $(ENGINE),$(RUN))") $(ARGS)

clean:
	rm -rf $(VENV) $(BPY) $(DOCS) build dist demo

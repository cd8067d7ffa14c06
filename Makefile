# Everything runs in an environment of its own (.venv), made from the Python found here.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin

# Container images often keep Python from writing bytecode: every process would compile all modules anew, for seconds.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup scan room object console scan-loopback scan-loopback-stream rig try-rig try-browser test lint check-types bytecode unit benchmark paper docs fuzz clean

help:
	@echo "make scan           set up, then scan a simulated room from three places into scans/room-sim/"
	@echo "make room           scan a whole simulated room from six stations into scans/room-whole-sim/"
	@echo "make object         scan a simulated object on a turntable from twelve sides into scans/object-sim/"
	@echo "make console        the same, and more, on a page in the browser"
	@echo "make test           set up, then run every check and every test"
	@echo "make setup          only make $(VENV)/, with the command $(BIN)/scan"
	@echo "make rig            set up for real devices: system packages (apt-get), PyGObject, pyglet"
	@echo "make scan-loopback  the same, then scan through a real window and a real camera protocol into scans/room-loopback/"
	@echo "make scan-loopback-stream  the same with a webcam, as a stream of JPEGs, into scans/room-loopback-stream/"
	@echo "make benchmark      measure accuracy and speed (minutes)"
	@echo "make paper          rebuild the paper's tables and figures into docs/results.md (an hour or two)"
	@echo "make docs           the documentation as a site into site/index.html"
	@echo "make fuzz           damage files at random for hours, and watch every reader (SEED=, INPUTS=, SECONDS=)"
	@echo "make clean          remove $(VENV)/ and caches; scans/ is kept"

# Installing waits for the network and the compiler for the processor: side by side.
setup: $(VENV)/.core
	@$(MAKE) --no-print-directory --jobs 2 $(VENV)/.console $(VENV)/.compiled

# What a scan does not need, Open3D and the packages of scan view and scan console, is installed when the result is there.
scan: $(VENV)/.core $(VENV)/.compiled
	$(BIN)/scan --config configs/room-sim.yaml --captures 3 --out scans/room-sim --overwrite
	@test -e $(VENV)/.console || echo "Installing what whole rooms, objects and pages in the browser need …"
	@$(MAKE) --no-print-directory $(VENV)/.console

room: setup
	$(BIN)/scan --config configs/room-whole-sim.yaml --stations 6 --out scans/room-whole-sim --overwrite

object: setup
	$(BIN)/scan --config configs/thing-sim.yaml --object --stations 12 --calibration configs/calibrations/thing-sim.yaml \
		--out scans/object-sim --overwrite

console: setup
	$(BIN)/scan console --config configs/room-sim.yaml

scan-loopback: rig
	$(BIN)/python tools/on_loopback.py scan --config configs/room-loopback.yaml --out scans/room-loopback --overwrite

scan-loopback-stream: rig
	$(BIN)/python tools/on_loopback.py --sending-jitter-ms 8 scan --config configs/room-loopback-stream.yaml \
		--out scans/room-loopback-stream --overwrite

rig: setup $(VENV)/.rig

# For tests: without these packages everything but the real devices is still to be tested.
try-rig:
	@test -e $(VENV)/.rig || $(MAKE) --no-print-directory $(VENV)/.rig || { \
		echo "*******************************************************************************"; \
		echo "* The rig's packages could not be installed (see above): the tests of the     *"; \
		echo "* real path, window, GigE Vision and synchronisation, will be SKIPPED.         *"; \
		echo "*******************************************************************************"; }

# For tests: without a browser everything but the pages of scan view and scan console is still to be tested.
try-browser:
	@tools/system-packages --browser || { \
		echo "*******************************************************************************"; \
		echo "* No browser could be installed (see above): the tests of the pages of        *"; \
		echo "* scan view and scan console will be SKIPPED.                                 *"; \
		echo "*******************************************************************************"; }

# Python's packages, Debian's and the compiler wait for different things, and what is checked needs one processor of two
# while the tests run.
test: $(VENV)/.core
	@$(MAKE) --no-print-directory --jobs 3 $(VENV)/.dev $(VENV)/.compiled try-system
	@$(MAKE) --no-print-directory --jobs 3 tests checks

# The checks begin while the last packages are installed and the tests collected.
.PHONY: tests
tests:
	@$(MAKE) --no-print-directory try-rig bytecode
	@$(MAKE) --no-print-directory unit

# What try-rig needs as well, which says so if it cannot be had.
.PHONY: try-system
try-system: try-browser | $(VENV)/.core
	@tools/system-packages $(BIN)/python > /dev/null 2>&1 || true

.PHONY: checks
checks:
	@$(MAKE) --no-print-directory lint
	@$(MAKE) --no-print-directory check-types

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

check-types: $(VENV)/.dev
	$(BIN)/mypy

# Of the tests and what they import, made once for all processes of pytest, which begin at the same time.
bytecode: $(VENV)/.dev
	@$(BIN)/pytest --collect-only > /dev/null || true # the tests will say why

# Two processes more than there are processors: tests of devices, pages and workers mostly wait.
unit: $(VENV)/.dev $(VENV)/.compiled
	$(BIN)/pytest -n $$(($$(getconf _NPROCESSORS_ONLN) + 2)) --dist loadgroup --no-loadscope-reorder

benchmark: $(VENV)/.dev try-rig
	@for file in benchmarks/bench_*.py; do \
		case $$file in *conditions.py|*paper.py) brief=--quick;; *rendered_room.py) continue;; *) brief=;; esac; \
		echo "== $$file"; OPENBLAS_NUM_THREADS=1 $(BIN)/python $$file $$brief || exit 1; \
	done

paper: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_paper.py

docs: $(VENV)/.dev
	$(BIN)/mkdocs build --quiet --strict
	@echo "Open site/index.html in a browser."

SEED   ?= 0
INPUTS ?= 50000
SECONDS ?= 600
fuzz: $(VENV)/.dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --seed $(SEED) --inputs $(INPUTS) --seconds $(SECONDS)

$(BIN)/pip:
	tools/make-venv $(PYTHON) $(VENV)

# The program runs from this folder. A copy of it in $(VENV), as `pip install .` makes, or what is left of one, would be
# found first: it goes, and the program is installed anew.
PACKAGES := calib hw scanner
COPIES   := $(wildcard $(addprefix $(VENV)/lib/python*/site-packages/,$(PACKAGES)))
# Bytecode is made of what is imported; pip would make it of everything, which takes half of the installation.
pip       = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
install   = $(pip) --editable '.$(1)' && rm -rf $(COPIES)

.PHONY: a-copy
a-copy:

# All but Open3D, which takes as long as all the rest and which few commands need: enough to compile and to scan with.
# What is installed later brings it, each in one go with what else it needs.
$(VENV)/.core: pyproject.toml $(if $(COPIES),a-copy) | $(BIN)/pip
	$(BIN)/python -c 'import tomllib; print(*(package for package in tomllib.load(open("pyproject.toml", "rb"))["project"] \
		["dependencies"] if not package.startswith("open3d")), sep="\n")' > $(VENV)/core.txt
	$(pip) --requirement $(VENV)/core.txt
	$(pip) --no-deps --editable . && rm -rf $(COPIES)
	@touch $@

# Machine code is kept for each file, in the user's cache folder, so a change costs only what it touches. Earlier versions
# kept it beside the sources.
$(VENV)/.compiled: $(shell grep -rl '^@compiled' calib hw scanner --include=*.py) | $(VENV)/.core
	@find $(PACKAGES) -name '*.nb[ic]' -delete
	PYTHONPATH=. $(BIN)/python tools/compile_ahead.py
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/.core
	$(call install,[dev])
	@tools/system-packages --open3d || echo "Everything but scan room works without them; its tests will be SKIPPED."
	@touch $@

$(VENV)/.console: pyproject.toml | $(VENV)/.core
	$(call install,[console])
	@tools/system-packages --open3d || echo "Everything but scan room works without them."
	@touch $@

$(VENV)/.rig: pyproject.toml tools/system-packages | $(VENV)/.core
	@tools/system-packages $(BIN)/python
	$(call install,[rig])
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# On a machine without ROS: installs the package and ROS 2's own wheels into .venv, and runs it.
# In a ROS workspace colcon does the same.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
# The same on the long-term release, for the tests that run nodes.
JAZZY := .venv-jazzy
ROS_TESTS := $(wildcard test/nodes/test_*node*.py test/nodes/shared/test_*node*.py) \
  $(addprefix test/, nodes/shared/test_attitude.py nodes/shared/test_messages.py \
  nodes/bringup/test_demo.py nodes/bringup/test_end_to_end.py estimation/test_fit_compiler.py \
  package/test_isolation.py)

# rclpy logs here, so the home may be read-only.
export ROS_LOG_DIR ?= $(CURDIR)/.venv/log
# A sourced ROS would shadow the wheels.
unexport AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH RMW_IMPLEMENTATION
# The wheels set this together with LD_LIBRARY_PATH, and trust it.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

.PHONY: help follow view tradeoff test jazzy docs linkcheck format promises bench peers clean

help:  ## show these lines
	@sed -n 's/^\([a-z]*\):.*  ## /  make \1\t/p' Makefile

follow: $(INSTALLED)  ## let one vehicle follow another; options by ARGS='...'
	@$(BIN)/uuv_array follow $(ARGS)

view: $(INSTALLED)  ## watch a follow in the browser; options by ARGS='...'
	@$(BIN)/uuv_array view $(ARGS)

tradeoff: $(INSTALLED)  ## measure and draw accuracy against computing time; options by ARGS='...'
	@$(BIN)/uuv_array study tradeoff $(ARGS)

# Three processes for two cores, as they wait for nodes and programs a third of the time, and in each
# of them one thread for algebra.
WORKERS = $(shell cores=$$(nproc); echo $$((cores > 5 ? 8 : (3 * cores + 1) / 2)))
test: export OPENBLAS_NUM_THREADS = 1
test: $(INSTALLED)  ## check style and types, and run all tests; those of the nodes on Jazzy too
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/pytest -n $(WORKERS) --dist worksteal
	@$(MAKE) --no-print-directory jazzy

jazzy: $(JAZZY)/installed  ## run the tests of the nodes on ROS 2 Jazzy
	$(JAZZY)/bin/pytest -n $(WORKERS) --dist worksteal $(ROS_TESTS)

docs: .venv/documents  ## write the reference and build the documentation, into docs/_build
	$(BIN)/python docs/generate_reference.py
	$(BIN)/sphinx-build -W --keep-going -q docs docs/_build
	@echo 'open docs/_build/index.html'

linkcheck: .venv/documents  ## look whether links of the documentation to other sites still lead there
	$(BIN)/sphinx-build -q -b linkcheck docs docs/_build/linkcheck

.venv/documents: $(INSTALLED)
	@$(BIN)/pip install -qq --disable-pip-version-check --no-build-isolation -c constraints.txt \
	  -e '.[docs]'
	@touch $@

format: $(INSTALLED)  ## bring the code into the house style
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

promises: export OPENBLAS_NUM_THREADS = 1
promises: $(INSTALLED)  ## measure whether what the package promises holds; options by ARGS='...'
	@$(BIN)/python benchmarks/promises.py $(ARGS)

bench: $(INSTALLED)  ## measure speed
	$(BIN)/pytest benchmarks
	@$(BIN)/python benchmarks/frames.py

peers: $(INSTALLED)  ## compare search and simulation with other libraries; options by ARGS='...'
	@PYTHONPATH=benchmarks $(BIN)/python -m peers $(ARGS)

clean:  ## remove .venv and all that can be made again
	rm -rf .venv $(JAZZY) docs/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

FIT := import ensurepip, platform as p, sys; sys.exit(not ((3, 10) <= sys.version_info < (3, 15) \
  and (p.system(), p.machine()) == ("Linux", "x86_64")))

COMPILE := from uuv_optical_array.estimation.fit_compiler import compile_fit; compile_fit()
# Python compiles at its first import what is imported, which is a small part of all.
QUICK := -qq --no-compile

.venv/installed: constraints-kilted.txt
$(JAZZY)/installed: constraints-jazzy.txt
%/installed: setup.py constraints.txt
	@$(PYTHON) -c '$(FIT)' 2>/dev/null || { echo 'This needs Python 3.10 to 3.14 with its venv' \
	  'module on x86-64 Linux (others: docs/how_to/install.md); name one with PYTHON=..., as in:' \
	  'make PYTHON=python3.12' >&2; exit 1; }
	@echo 'Installing into $*; this takes a minute, once'
	@$(PYTHON) -m venv --clear $*
	@$*/bin/pip install $(QUICK) --disable-pip-version-check -c constraints.txt pip setuptools
	@$*/bin/pip install $(QUICK) --no-build-isolation -c constraints.txt -e '.[fast]'
	@# The fit compiles beside the rest of this, and then beside the first command.
	@$*/bin/python -c '$(COMPILE)' < /dev/null > /dev/null 2>&1 & \
	$*/bin/pip install $(QUICK) --no-build-isolation $(patsubst %,-c %,$(filter constraints%,$^)) \
	  -e '.[ros,test]'
	@touch $@

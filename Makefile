# The everyday commands; `make` lists them. Nothing is installed outside the folder $(VENV).

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip
# Python compiles a module when it is first imported; all of them would take 15 s here.
INSTALL := $(PIP) install --quiet --no-compile --no-build-isolation --constraint constraints.txt
PACKAGES := servo_msgs_py servo_bridge servo_twin

# Serial port or pyserial URL of a real board, and its speed; without PORT there is a virtual board.
PORT ?=
BAUD ?=
# Parameters of the board, each NAME=VALUE, separated by spaces.
SET ?=
# How closely virtual boards are modelled: registers, or ideal for speed; else $SERVO_TWIN_LEVEL, or registers.
LEVEL ?=
ifneq ($(LEVEL),)
export SERVO_TWIN_LEVEL := $(LEVEL)
endif
# A text as one word of the shell, and an option with the value of a variable, if it has one. The value may contain any character
# but a line break; the variables NAME_ARGS are words of the shell.
quoted = '$(subst ','\'',$(1))'
option = $(if $(value $(2)),$(1) $(call quoted,$(value $(2))))
# A test that hangs fails; one that hangs where Python cannot interrupt it ends the run with the stack of every thread.
TIMEOUTS := --timeout 900 --timeout-method signal -o faulthandler_exit_on_timeout=true
PYTEST = $(BIN)/python -m pytest $(TIMEOUTS) $(PYTEST_ARGS)
REALTIME := --timeout 120 -o faulthandler_timeout=180 -o cache_dir=.pytest_cache/realtime
# Only their files are collected, unless PYTEST_ARGS may name others.
REALTIME_FILES = $(if $(PYTEST_ARGS),,$(shell grep -rl --include='test_*.py' 'mark\.realtime' firmware $(PACKAGES) tests))
# What the programs import.
IMPORTED := matplotlib.figure, rerun.blueprint, servo_bridge.command_paths, servo_bridge.demo, servo_bridge.motions, \
            servo_bridge.node, servo_bridge.tool, servo_twin.node, servo_twin.up, servo_twin.viewer_node, \
            servo_twin.virtual_board
# Many tests compile the C sources. With ccache (if there is one) a file that has been compiled is taken from the cache, where
# the compiler lists the headers (-MD) without a run of the preprocessor; without link-time optimisation the rest takes a
# fourth of the time. The numbers are the same bits. It is the cache of the user: another checkout finds the same files.
CCACHE := $(wildcard /usr/lib/ccache)
# The pytest of Ubuntu 24.04, used by `colcon test` there.
UBUNTU_PYTEST := $(VENV)/pytest-7.4
# Tests publish commands: a domain of their own keeps them away from other nodes. Each worker adds its number (tests/conftest.py).
TEST_DOMAIN_ID ?= $(shell echo $$(( $$$$ % 22 * 4 + 10 )))

NATIVE := $(shell find firmware servo_twin/native -name '*.[ch]') servo_twin/setup.py \
          $(wildcard servo_twin/servo_twin/_*.py servo_twin/servo_twin/core_weights.toml firmware/config/*.toml \
            servo_msgs_py/servo_msgs_py/boards/*.toml)
METADATA := $(foreach package,$(PACKAGES),$(wildcard $(addprefix $(package)/,\
              pyproject.toml setup.py setup.cfg package.xml resource/* scripts/* config/* launch/*)))
# For processors that know AVX2, like the one at hand: 7 % fewer instructions, the same bits (hence without FMA). ARCH= for any
# x86-64.
ARCH ?= $(shell /lib64/ld-linux-x86-64.so.2 --help 2>/dev/null | grep -q 'x86-64-v3 .supported' && \
          $(CC) -march=x86-64-v3 -E -x c /dev/null >/dev/null 2>&1 && echo -march=x86-64-v3 -mno-fma)
# The compiled virtual boards, a stamp for each level. Objects of ../firmware are put beside the folder of objects: each has one of its own.
BOARDS := $(VENV)/.ideal $(VENV)/.registers $(VENV)/.odrive36 $(VENV)/.odrive36_ideal
# Board of `demo`, `up` and `experiments`: that of the DSC, unless `make BOARD=...` or SERVO_BOARD names another one. A BOARD of the
# environment is that of another build system.
ifeq ($(origin BOARD),environment)
undefine BOARD
endif
CHOSEN_BOARD := $(or $(BOARD),$(SERVO_BOARD))
# `demo` and `up` of the default board need only its own.
USED_BOARDS := $(if $(filter-out demo up,$(or $(MAKECMDGOALS),help))$(CHOSEN_BOARD),$(BOARDS),$(wordlist 1,2,$(BOARDS)))
READY := $(VENV)/.native $(USED_BOARDS)
CONFTESTS = $(shell find firmware $(PACKAGES) tests -name conftest.py)
PARAMETER_FILES := servo_bridge/config/servo_bridge.yaml servo_twin/config/servo_twin.yaml servo_twin/config/servo_viewer.yaml
TESTS := test test-simulated test-realtime
C_CORE := $(wildcard $(foreach folder,math control sensing diagnosis drive app comm config,firmware/$(folder)/*.c))
C_MODELS := $(wildcard servo_twin/native/arm/*.c servo_twin/native/chip/*.c servo_twin/native/stm32f405/*.c servo_twin/native/plant/*.c)
# The start-up is assembly in part; the drivers of the DSC need its compiler.
C_PORT := $(filter-out %/startup.c,$(wildcard firmware/port/stm32f405/*.c))
C_LINT := --std=c99 -Ifirmware -Iservo_twin/native
C_FILES := $(filter-out %_gen.c %_gen.h,$(filter %.c %.h,$(NATIVE))) $(shell find tests -name '*.[ch]')

# `demo` and `up` execute the ELF file of the board, if there is a compiler.
ifneq ($(CHOSEN_BOARD),)
demo up experiments: export SERVO_BOARD := $(CHOSEN_BOARD)
endif
ELF_odrive36 := firmware/port/stm32f405/build/servo.elf
ELF := $(if $(shell command -v arm-none-eabi-gcc),$(ELF_$(CHOSEN_BOARD)))
ifneq ($(filter-out registers,$(LEVEL)),)
ELF :=
endif
ifneq ($(ELF),)
demo up: firmware
endif
# Board of `make firmware`, its configuration of the controller, and its generated files.
BOARD ?= odrive36
BOARD_CONFIG = firmware/config/$(BOARD).toml
BOARD_FILES = $(VENV)/boards/$(BOARD)
generated_for = SERVO_BOARD=$(1) PYTHONPATH=servo_msgs_py $(BIN)/python -m servo_msgs_py.codegen --output $(2) && \
  SERVO_BOARD=$(1) PYTHONPATH=servo_msgs_py $(BIN)/python firmware/config/tune.py generate --config firmware/config/$(1).toml \
  --output $(2)/config/servo_config_gen.c
FLASH_TOOL ?= openocd
IMAGE := firmware/port/stm32f405/build
PROGRAM := $(IMAGE)/program.bin 0x08010000
START := $(IMAGE)/start.bin 0x08000000
DFU = dfu-util -a 0 -d 0483:df11 -D $(firstword $(1)) -s $(lastword $(1))
FLASH_openocd = openocd -f interface/stlink.cfg -f target/stm32f4x.cfg -c "program $(PROGRAM) verify" -c "program $(START) verify reset exit"
FLASH_st-flash = st-flash write $(PROGRAM) && st-flash --reset write $(START)
FLASH_dfu-util = $(call DFU,$(PROGRAM)) && $(call DFU,$(START)):leave
ifneq ($(filter flash,$(MAKECMDGOALS)),)
ifneq ($(BOARD),odrive36)
$(error `make flash` is for the board odrive36, not for $(BOARD))
endif
ifeq ($(FLASH_$(FLASH_TOOL)),)
$(error FLASH_TOOL is openocd, st-flash or dfu-util, not $(FLASH_TOOL))
endif
endif

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
.PHONY: help setup extras demo up experiments bench bench-damage bench-firmware firmware flash chip-budget bench-twin bench-fmu bench-state bench-robot launch-tools targets fuzz test test-simulated test-realtime lint format build fast generate tune clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "variables: PORT=/dev/ttyUSB0 or a pyserial URL, BAUD=115200, SET='NAME=VALUE ...' for parameters of the board (up); LEVEL=ideal (demo, up, experiments, test); PYTHON=python3.12 (setup); PYTEST_ARGS=..., MARKS='not slow' (test); TARGETS_ARGS='--seed 2' (targets)"

setup: $(READY) ## virtual environment with everything that runs
	@echo "ready: $(BIN)"

extras: $(VENV)/.extras ## Dask for `servo-sim --scheduler`, Optuna for `tune-robust`, MuJoCo for `robot`

demo: $(READY) ## move both axes of a virtual board over ROS; table, out/demo.rrd, out/demo.png; BOARD=odrive36
	@$(BIN)/servo-up --demo --out out $(ELF:%=--elf %)

up: $(READY) ## board, bridge, twin and viewer until Ctrl-C; PORT=... for a real board, SET=... for its parameters; BOARD=odrive36
	@$(BIN)/servo-up $(ELF:%=--elf %) $(call option,--port,PORT) $(call option,--baud,BAUD) $(foreach set,$(value SET),--set $(call quoted,$(set)))

experiments: $(READY) ## repeat the experiments of the reference design; tables and pictures in out/experiments
	@$(BIN)/servo-sim experiment all --out out/experiments

bench: $(READY) $(VENV)/.dev ## telemetry, latency and download against the wire; cost of a lost frame; error along a path; recording of a run; real-time factor of a board
	@ROS_DOMAIN_ID=$(TEST_DOMAIN_ID) ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST $(BIN)/python tests/bench/telemetry.py
	@$(BIN)/python tests/bench/link.py
	@ROS_DOMAIN_ID=$(TEST_DOMAIN_ID) ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST $(BIN)/python tests/bench/download.py
	@$(BIN)/python tests/bench/trajectories.py
	@$(BIN)/python tests/bench/sweep.py
	@$(BIN)/python tests/bench/recording.py
	@$(BIN)/servo-sim bench

bench-damage: $(READY) $(VENV)/.dev ## a million damaged frames between client and server; DAMAGE_ARGS='--frames 1000'
	@$(BIN)/python tests/bench/damage.py $(DAMAGE_ARGS)

bench-firmware: $(READY) ## instructions and bytes of the firmware on a Cortex-M3; UPDATE=1 writes the committed table
	@PYTHONPATH=tests $(BIN)/python tests/bench/firmware.py $(if $(UPDATE),--update)

# The generated files of the checkout are those of the DSC; another board has its own beside its objects.
firmware: $(VENV)/.created ## firmware by arm-none-eabi-gcc as .elf, .hex and, for the flash, .bin, with its sizes; BOARD=odrive36 or mc56f84789_m4, OPT=-Os
	@$(if $(wildcard $(BOARD_CONFIG)),$(call generated_for,$(BOARD),$(BOARD_FILES)))
	@$(MAKE) --no-print-directory -C firmware/port BOARD=$(BOARD) $(if $(OPT),OPT=$(OPT)) $(if $(wildcard $(BOARD_CONFIG)),GENERATED=$(CURDIR)/$(BOARD_FILES))

flash: firmware ## write the firmware to an odrive36 (firmware/port/stm32f405/README.md); FLASH_TOOL=openocd, st-flash or dfu-util
	@command -v $(FLASH_TOOL) >/dev/null || { echo "$(FLASH_TOOL) is missing: sudo apt-get install openocd stlink-tools dfu-util" >&2; exit 1; }
	$(FLASH_$(FLASH_TOOL))

chip-budget: ## stack and RAM of the chip, estimated with arm-none-eabi-gcc and avr-gcc
	@python3 firmware/port/chip_budget.py

bench-twin: $(VENV)/.fast ## how fast a virtual board is, at both levels; where its time goes; against other simulators
	@PYTHONPATH=tests $(BIN)/python tests/bench/twin.py
	@$(BIN)/python tests/bench/plant.py

bench-fmu: $(READY) $(VENV)/.dev ## bits of an exported FMU against those of the native board, over a million PWM periods
	@PYTHONPATH=servo_twin/test $(BIN)/python tests/bench/fmu.py

bench-state: $(READY) ## size of the state of a virtual board, time to save and to restore it
	@$(BIN)/python tests/bench/board_state.py

bench-robot: $(READY) $(VENV)/.dev ## times real time of a two-joint arm in MuJoCo, beside the same arm with <dcmotor>
	@$(BIN)/python tests/bench/robot.py

# They have no wheels. composition_interfaces is a package of generated messages that launch_ros imports and our files do not use.
launch-tools: $(VENV)/.packages ## `ros2 launch`, for the tests, from a folder with checkouts of the ROS 2 repositories; ROS2_SOURCES=DIR
	@: $${ROS2_SOURCES:?a folder with jazzy checkouts of launch, launch_ros, ros2cli and osrf_pycommon}
	@rm -rf $(VENV)/ros2launch
	@$(PIP) install --quiet --no-deps --no-build-isolation --target $(VENV)/ros2launch $(addprefix "$$ROS2_SOURCES"/,osrf_pycommon \
	  launch/launch launch/launch_xml launch/launch_yaml launch_ros/launch_ros launch_ros/ros2launch $(addprefix ros2cli/,ros2cli \
	  ros2interface ros2node ros2param ros2pkg ros2run ros2service ros2topic))
	@mkdir $(VENV)/ros2launch/composition_interfaces
	@printf 'class LoadNode:\n    class Request: ...\n    class Response: ...\n' >$(VENV)/ros2launch/composition_interfaces/srv.py

targets: $(READY) ## the same bits everywhere: replay recorded runs on every compiler and machine
	@PYTHONPATH=tests $(BIN)/python -m targets $(TARGETS_ARGS)

fuzz: $(READY) ## libFuzzer (clang) on the FreeMASTER server for FUZZ_SECONDS=600; inputs that it finds in out/fuzz
	@$(BIN)/python firmware/test/freemaster_fuzz.py $(call option,--seconds,FUZZ_SECONDS)

# Tests in real time mostly wait for the clock. The others use the rest of the processors, with the lowest priority: as processes,
# and as a session, because Linux may share the processors among sessions first (autogroup). Their output comes last.
test: $(READY) $(VENV)/.dev ## every check and every test
	@setsid chrt --idle 0 sh -c '{ echo 19 >/proc/self/autogroup; } 2>/dev/null; exec $(MAKE) --no-print-directory test-simulated' \
	  >$(VENV)/test-simulated.log 2>&1 & simulated=$$!; \
	trap 'kill -TERM -$$simulated; wait; exit 1' HUP INT TERM; \
	status=0; $(MAKE) --no-print-directory test-realtime || status=1; \
	tail --pid=$$simulated --lines=+1 --follow $(VENV)/test-simulated.log; \
	wait $$simulated || status=1; exit $$status

test-simulated: $(READY) $(VENV)/.dev ## make lint, and the tests that do not keep real time (part of test)
	@status=0; $(MAKE) --no-print-directory lint || { status=1; echo "make lint fails (above)"; }; \
	echo "== pytest: on every core"; \
	$(PYTEST) -m $(call quoted,not realtime$(if $(value MARKS), and ($(value MARKS)))) -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0 || \
	  [ $$? -eq 5 ] || status=1; \
	exit $$status

# Two at a time, each in a ROS domain of its own. Two chains of processes may overload two cores for a moment: what fails is run
# once more, alone; the last line counts what passed only then.
test-realtime: $(READY) $(VENV)/.dev ## tests of nodes, lines and processes in real time (part of test)
	@failed() { cat .pytest_cache/realtime/v/cache/lastfailed 2>/dev/null | grep -c ': true'; }; \
	run() { $(PYTEST) -m $(call quoted,realtime$(if $(value MARKS), and ($(value MARKS)))) $(REALTIME) $(REALTIME_FILES) "$$@"; result=$$?; }; \
	echo "== pytest: in real time"; run -n 2 --dist loadfile --max-worker-restart 1; repeated=0; \
	if [ $$result -eq 1 ]; then \
	  echo "== pytest: what failed in real time, alone"; \
	  repeated=$$(failed); run --last-failed; repeated=$$((repeated - $$(failed))); \
	fi; \
	[ $$repeated -eq 0 ] || echo "tests in real time that passed only when repeated alone: $$repeated"; \
	[ $$result -eq 0 ] || [ $$result -eq 5 ]

# The checks of the C sources run beside those of Python; their output comes last.
lint: $(VENV)/.dev ## ruff, mypy, clang-format, clang-tidy and cppcheck, changing nothing
	@status=0; ( status=0; \
	echo "== clang-format"; $(BIN)/clang-format --dry-run -Werror $(C_FILES) || status=1; \
	echo "== clang-tidy"; $(BIN)/clang-tidy --quiet $(C_CORE) $(C_MODELS) -- $(C_LINT) -Wshadow 2>$(VENV)/clang-tidy.log || status=1; \
	$(call generated_for,odrive36,$(VENV)/boards/odrive36) >/dev/null && $(BIN)/clang-tidy --quiet $(C_PORT) -- -iquote $(VENV)/boards/odrive36 -DCHIP_ON_HOST \
	  $(C_LINT) -Wshadow 2>>$(VENV)/clang-tidy.log || status=1; \
	echo "== cppcheck"; $(BIN)/cppcheck --quiet --max-configs=1 --enable=warning,style,performance,portability --error-exitcode=1 \
	  --suppressions-list=.cppcheck-suppressions $(C_LINT) $(C_CORE) $(filter-out servo_twin/native/plant/%,$(C_MODELS)) || status=1; \
	exit $$status ) >$(VENV)/lint-c.log 2>&1 & checks=$$!; \
	echo "== ruff"; $(BIN)/ruff check --quiet || status=1; $(BIN)/ruff format --quiet --diff || status=1; \
	echo "== mypy"; $(BIN)/mypy || status=1; \
	for conftest in $(CONFTESTS); do $(BIN)/mypy --no-error-summary $$conftest || status=1; done; \
	wait $$checks || status=1; cat $(VENV)/lint-c.log; \
	exit $$status

format: $(VENV)/.dev ## lay out Python and C sources
	$(BIN)/ruff check --quiet --fix --select I
	$(BIN)/ruff format
	$(BIN)/clang-format -i $(C_FILES)

build: $(READY) ## compile the firmware and the virtual board (part of setup)

fast: $(VENV)/.fast ## compile the virtual board anew, guided by a profile of itself: faster until a source changes, results equal except for rounding

$(VENV)/.fast: $(VENV)/.native
	@rm -f $(VENV)/.native $(BOARDS)
	@SERVO_TWIN_FLAGS='$(ARCH)' $(BIN)/python tests/bench/guided_build.py --profile $(VENV)/profile
	@touch $(BOARDS) $(VENV)/.native $@

# Not from the installed packages: while the generated files are stale, the extension among them may not compile.
generated-sources tune: export PYTHONPATH := servo_msgs_py
.PHONY: generated-sources
generated-sources: $(VENV)/.created
	@$(BIN)/python -m servo_msgs_py.codegen
	@$(BIN)/python firmware/config/tune.py

generate: generated-sources ## rewrite the committed generated files
	@$(MAKE) --no-print-directory $(VENV)/.native
	@for file in $(PARAMETER_FILES); do \
	  $(BIN)/$$(basename $$file .yaml) --parameter-file >$(VENV)/parameters.yaml || exit; \
	  cmp -s $(VENV)/parameters.yaml $$file || cp $(VENV)/parameters.yaml $$file; done

tune: $(VENV)/.created ## margins, poles and sensitivity of the gains that servo.toml gives; CONFIG=... for another file
	@$(BIN)/python firmware/config/tune.py report $(call option,--config,CONFIG)

clean: ## remove everything that the other targets made
	rm -rf $(VENV) out .hypothesis .mypy_cache .pytest_cache .ruff_cache
	rm -rf $(foreach package,$(PACKAGES),$(package)/build $(package)/*.egg-info) servo_twin/servo_twin/*.so
	find $(PACKAGES) firmware tests -type d -name __pycache__ -prune -exec rm -rf {} +

demo $(TESTS): export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
$(TESTS): export ROS_DOMAIN_ID := $(TEST_DOMAIN_ID)
$(TESTS): export SERVO_TWIN_FLAGS := $(ARCH) -O1 -g0 -fno-lto -MD
$(TESTS): export PATH := $(addsuffix :,$(CCACHE))$(PATH)
$(TESTS): export CCACHE_BASEDIR := $(CURDIR)
$(TESTS): export CCACHE_NOHASHDIR := 1
$(TESTS): export CCACHE_DEPEND := 1
# Tests start some hundred processes; without byte code each compiles what it imports, the bridge for 0.2 s.
$(TESTS): export PYTHONDONTWRITEBYTECODE :=

# ---- how the environment is made -------------------------------------------------------------------------------------
# The stamps make a second run quick. A sourced ROS lends its rclpy to the environment; without one it comes as wheels.

$(VENV)/.created:
	@python=$$(sh .ci/check-tools) && \
	echo "[1/2] virtual environment $(VENV) with $$python" && \
	"$$python" -m venv --clear $(if $(ROS_DISTRO),--system-site-packages) $(VENV)
	@$(PIP) install --quiet --no-compile --constraint constraints.txt setuptools cffi numpy 'tomli; python_version < "3.11"'
	@touch $@

# The packages are installed while the C is compiled: one waits for the network, the other for the processor.
$(VENV)/.native: $(VENV)/.created Makefile constraints.txt $(METADATA) $(NATIVE)
	@$(MAKE) --no-print-directory --jobs=3 $(VENV)/.packages $(USED_BOARDS)
	@# With PYTHONDONTWRITEBYTECODE each program would compile these at every start, which takes as long as the rest of it.
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -c 'import $(IMPORTED)'
	@touch $@

$(VENV)/.packages: $(VENV)/.created Makefile constraints.txt $(METADATA)
	@if [ -n "$(ROS_DISTRO)" ] && $(BIN)/python -c 'import rclpy' 2>/dev/null; then \
	  echo "[2/2] rclpy of the sourced ROS 2 $(ROS_DISTRO), rerun and matplotlib"; ros=; \
	else echo "[2/2] ROS 2 Jazzy, rerun and matplotlib"; ros=ros,; fi; \
	SERVO_TWIN_MODULES= $(INSTALL) --editable "./servo_msgs_py[$${ros}record]" --editable ./servo_bridge --editable './servo_twin[viewer,parquet]'
	@# An editable install leaves data files out: the ament index, launch files and what `ros2 run` starts.
	@for package in $(PACKAGES); do (cd $$package && SERVO_TWIN_MODULES= \
	  ../$(BIN)/python -W ignore setup.py --quiet install_data --install-dir "$(CURDIR)/$(VENV)") || exit; done
	@touch $@

$(VENV)/.ideal: MODULE := ffi
$(VENV)/.registers: MODULE := registers_ffi
$(VENV)/.odrive36: MODULE := odrive36_ffi
$(VENV)/.odrive36_ideal: MODULE := odrive36_ideal_ffi
$(BOARDS): $(VENV)/.created $(NATIVE)
	@echo "      compiling firmware and virtual board, level $(patsubst .%,%,$(@F))"
	@cd servo_twin && SERVO_TWIN_MODULES=$(MODULE) SERVO_TWIN_FLAGS='$(ARCH)' ../$(BIN)/python -W ignore setup.py --quiet \
	  build_ext --inplace --force --build-temp build/$(MODULE)/objects
	@touch $@

$(VENV)/.extras: $(VENV)/.packages
	@$(INSTALL) 'servo_twin[cluster,tune,mujoco]'
	@touch $@

# Descriptions of a chip by others, against which the tests check register definitions: files of two packages, whose programs
# are not used.
$(VENV)/.chips: $(VENV)/.created Makefile
	@$(PIP) install --quiet --no-compile --no-deps --upgrade --target $(VENV)/chip-descriptions pyocd==0.46.0 modm-devices==0.13.1
	@touch $@

$(VENV)/.dev: $(VENV)/.packages $(VENV)/.chips pyproject.toml
	@echo "[dev] tools for tests and checks"
	@$(PIP) install --quiet --no-compile --constraint constraints.txt pip # the one of venv may not know groups
	@$(INSTALL) --group dev
	@$(PIP) install --quiet --no-compile --no-deps --upgrade --target $(UBUNTU_PYTEST) pytest==7.4.4
	@touch $@

# Virtual borders by laser pointer: the commands. `make help` lists them.
SHELL := /bin/bash

SCENARIO ?= carpet
METHOD   ?= nrs
WORLD    ?=
SEED     ?= 1
NAVIGATION ?= standin
QUICK    ?=
CONFIG   ?=
OUT      ?= out/study
CAMERA   ?=
PROCESSES ?=

.DEFAULT_GOAL := help
.PHONY: help setup navigation try demo test unit rostest study clean

help: ## this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 13

setup: ## system packages, virtual environment, catkin build (each only where needed)
	@scripts/setup

navigation: setup ## builds the real navigation stack beside this workspace (Debian): NAVIGATION_SOURCE=git repository
	@scripts/navigation

try: setup ## a camera, a laser pointer and a browser: CAMERA=0|/dev/...|rtsp://...|http://...|FILE; without one, a video of ours
	@. scripts/env.sh && python3 scripts/try --camera "$(CAMERA)"

demo: setup ## the simulated lab: SCENARIO=room|carpet|corner METHOD=nrs|robot_only NAVIGATION=standin|move_base WORLD=file SEED=number
	@. scripts/env.sh && python3 scripts/demo --scenario "$(SCENARIO)" --method "$(METHOD)" --world "$(WORLD)" --seed "$(SEED)" \
	    --navigation "$(NAVIGATION)"

test: setup ## all tests
	@. scripts/env.sh && python3 scripts/test

unit: setup ## only the unit tests, without a ROS master
	@. scripts/env.sh && python3 scripts/test --only unit

rostest: setup ## only the tests of nodes
	@. scripts/env.sh && python3 scripts/test --only rostest

study: setup ## the paper's experiment with simulated people, into out/study: QUICK=1 CONFIG=file OUT=folder PROCESSES=number
	@. scripts/env.sh && python3 -m vb_evaluation.simulated_study --out "$(OUT)" $(if $(QUICK),--quick) \
	    $(if $(CONFIG),--config "$(CONFIG)") $(if $(PROCESSES),--processes $(PROCESSES)) \
	    $(if $(filter-out file,$(origin SEED)),--seed $(SEED)) \
	    && python3 -m vb_evaluation.user_study report "$(OUT)"

clean: ## removes what was built and written, keeps the system packages
	rm -rf build devel install logs out .venv navigation_ws src/CMakeLists.txt .catkin_workspace

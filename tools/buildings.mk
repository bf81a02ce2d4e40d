# SPDX-License-Identifier: GPL-3.0-or-later
# Many buildings of one scene: one job per building, as many side by side as -j says.
#
#     make -f tools/buildings.mk -j2 SCENE=town PROMPTS=clicks OUT=jobs OPTIONS="--preset draft"
#
# PROMPTS is a folder with one file of clicks per building: clicks/church.json becomes jobs/church. Photos and cameras are
# read once. Jobs that are finished are left alone, jobs that were stopped go on where they were, new clicks make the
# building anew. THREADS is for each job; paths must not contain spaces, for make splits at them.
MGF ?= mgf
OUT ?= jobs
THREADS ?= 1
OPTIONS ?=
COMMON = --threads $(THREADS) $(OPTIONS)
BUILDINGS := $(basename $(notdir $(wildcard $(PROMPTS)/*.json)))

ifeq ($(and $(SCENE),$(BUILDINGS)),)
$(error Give SCENE=folder and PROMPTS=folder with one JSON file of clicks per building)
endif

all: $(BUILDINGS:%=$(OUT)/%/report.html)

$(OUT)/.scene/job.json:
	$(MGF) scene $(SCENE) --out $(OUT)/.scene --resume $(COMMON)

$(OUT)/%/report.html: $(PROMPTS)/%.json $(OUT)/.scene/job.json
	test -e $(@D)/job.json || cp -r $(OUT)/.scene $(@D)
	$(MGF) reconstruct $(SCENE) --prompts $< --out $(@D) --resume $(COMMON)
	touch $@

.PHONY: all

# SPDX-License-Identifier: GPL-3.0-or-later
"""Write docs/cli.md from the command line itself, docs/algorithms.md from the algorithms' options, and the table of
stages in docs/architecture.md.

.venv/bin/python tools/write_docs.py          (tests/test_docs.py checks that the pages are current)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

REPO = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPO))

from mgf_engine.cli.arguments import Parser, make_parser  # noqa: E402
from mgf_engine.cli.option_list import default_text  # noqa: E402
from mgf_engine.options import algorithm_table  # noqa: E402
from mgf_engine.options.config import option_fields, options_schema  # noqa: E402
from mgf_engine.options.presets import PRESETS  # noqa: E402
from mgf_engine.stages import STAGE_NAMES, STAGES  # noqa: E402

CLI, ARCHITECTURE = REPO / "docs" / "cli.md", REPO / "docs" / "architecture.md"
ALGORITHMS = REPO / "docs" / "algorithms.md"
_BEGIN, _END = "<!-- stages: begin -->", "<!-- stages: end -->"
_HEAD = """\
# Command line

<!-- Written by tools/write_docs.py; change the help texts in the sources and run it again. -->

```
mgf COMMAND [ARGUMENTS]          python -m mgf_engine is the same
```

| exit code | meaning |
|---|---|
| 0 | finished |
| 1 | an error of MGF; the message names the log |
| 2 | a problem with the input; one sentence says what is wrong and what to do |
| 3 | cancelled; `--resume` continues |

`Ctrl-C` cancels a job at its next step, a second `Ctrl-C` at once. `MGF_CACHE` names another cache folder,
`MGF_KERNEL_VARIANT` another variant of the kernels. `mgf bench` runs benchmarks from a checkout; see
[benchmark.md](benchmark.md).
"""
_ALGORITHMS_HEAD = """\
# Options of the algorithms

<!-- Written by tools/write_docs.py; change the sentences in the sources and run it again. -->

The numbers of the algorithms, for experiments and ablations. They are in no panel, and their defaults are what all
[results](results.md) were made with. Set them by name: `mgf reconstruct … --set random_walker.rounds=6`, in a JSON
file after `--config` (`{"random_walker.rounds": 6}`), or from Python
(`mgf.reconstruct(…, **{"random_walker.rounds": 6})`). A number with several parts is given with commas (`5,14`). A
changed option redoes its stage and the later ones, like any other. `mgf georef`, `mgf drawings`, `mgf models` and
`mgf preview` take `--set` and `--config` for the algorithms that they run, and otherwise what the job was made with.
`mgf options --algorithms` prints this list, with `--json` as data that has the limits, too.

px is a pixel of a working photo; a ground pixel is its size on the surface in the nearest photo that shows it.
"""
_OPTIONS = """
## Options of a job

`mgf reconstruct`, the stage commands and `mgf estimate` take these options: as flags (`--max-photos 60`,
`--no-texture`), after `--set` (`--set max_photos=60`), or in a JSON file after `--config` (`{"max_photos": 60}`). A
flag wins over `--set`, `--set` over the file, and all of them over the preset. The panel in Blender shows the same
options.
"""


def cli_page() -> str:
    """Compose the whole page."""
    commands = _commands()
    same = [
        name for name in commands if name != "reconstruct" and _rows(commands, name) == _rows(commands, "reconstruct")
    ]
    parts = [_HEAD, "## Commands", "", "| command | purpose |", "|---|---|"]
    for name, (_, help) in commands.items():
        anchor = "mgf-reconstruct" if name in same else f"mgf-{name}"
        parts.append(f"| [`mgf {name}`](#{anchor}) | {_cell(help)} |")
    for name, (parser, help) in commands.items():
        if name not in same:
            parts += ["", f"## mgf {name}", "", _sentence(help), *_arguments(parser, _rows(commands, name))]
        if name == "reconstruct":
            parts += ["", f"`mgf {'`, `mgf '.join(same)}` take the same arguments and stop after their stage."]
    return "\n".join([*parts, _OPTIONS.rstrip("\n"), *_preset_table(), *_option_tables()]) + "\n"


def algorithms_page() -> str:
    """Compose the page of the algorithms' options: a table for each algorithm, in the order of the stages."""
    parts = [_ALGORITHMS_HEAD.rstrip("\n")]
    for stage in (*STAGE_NAMES, *algorithm_table.COMMANDS):
        algorithms = [a for a in algorithm_table.ALGORITHMS if a.stage == stage]
        if algorithms:
            parts += ["", f"## Stage {stage}" if stage in STAGE_NAMES else f"## mgf {stage}"]
        for algorithm in algorithms:
            source = "mgf_engine/" + algorithm.options.partition(":")[0].replace(".", "/") + ".py"
            also = "".join(f"; also in `mgf {command}`" for command in algorithm.also)
            parts += ["", f"### {algorithm.section}", "", f"{algorithm.title} (`{source}`){also}.", ""]
            parts += ["| option | default | meaning |", "|---|---|---|"]
            for spec in algorithm.parameters():
                default = default_text(spec.default, spec.metadata["unit"])
                parts.append(f"| `{algorithm.section}.{spec.name}` | {default} | {_cell(spec.metadata['help'])} |")
    return "\n".join(parts) + "\n"


def architecture_page() -> str:
    """Compose docs/architecture.md: the page as it is, with the table of stages between its marks."""
    head, _, rest = ARCHITECTURE.read_text(encoding="utf-8").partition(_BEGIN)
    tail = rest.partition(_END)[2]
    rows = ["| stage | what it does | reads | writes | function |", "|---|---|---|---|---|"]
    for stage in STAGES:
        reads = ", ".join(f"`{name}`" for name in stage.reads) or "the user's files"
        writes = ", ".join(f"`{path}`" for path in stage.output_paths)
        rows.append(f"| `{stage.name}` | {_cell(stage.help)} | {reads} | {writes} | `{stage.run}` |")
    return head + "\n".join([_BEGIN, "", *rows, "", _END]) + tail


def _commands() -> dict[str, tuple[Parser, str]]:
    """Name -> parser and help of every command that has arguments of its own here."""
    return {name: command for name, command in make_parser().commands.items() if name != "bench"}


def _rows(commands: dict[str, tuple[Parser, str]], name: str) -> list[str]:
    """The table rows of a command's own arguments; options of a job have tables of their own."""
    actions = [
        a for a in commands[name][0].arguments if "--help" not in a.option_strings and a.help != argparse.SUPPRESS
    ]
    helps = tuple(f.metadata["help"] for f in option_fields())
    own = [a for a in actions if not (a.help or "").startswith(helps)]
    return [f"| `{_cell(_usage(action))}` | {_cell(action.help or '')} |" for action in own]


def _arguments(parser: Parser, rows: list[str]) -> Iterator[str]:
    if rows:
        yield from ("", "| argument | meaning |", "|---|---|", *rows)
    taken = {a.dest for a in parser.arguments}
    sections = {f.metadata["section"] for f in option_fields() if f.name in taken}
    if "mesh" in sections:
        yield from ("", "It also takes all [options of a job](#options-of-a-job).")
    elif "georef" in sections:
        yield from ("", "It also takes the options of the section [georef](#georef).")


def _usage(action: argparse.Action) -> str:
    """An argument as it is typed."""
    shown = " ".join(action.metavar) if isinstance(action.metavar, tuple) else action.metavar
    value = shown or ("|".join(map(str, action.choices)) if action.choices else action.dest.upper())
    if not action.option_strings:
        return value
    return action.option_strings[0] if action.nargs == 0 else f"{action.option_strings[0]} {value}"


def _preset_table() -> Iterator[str]:
    yield from ("", "| preset | changes from the defaults |", "|---|---|")
    for name, values in PRESETS.items():
        changes = ", ".join(f"`{option}={_value(value)}`" for option, value in values.items())
        yield f"| `{name}` | {changes or 'none'} |"


def _option_tables() -> Iterator[str]:
    schema = options_schema()
    for section in schema["sections"]:
        entries = [o for o in schema["options"] if o["section"] == section]
        expert = [o for o in entries if o["level"] == "expert"]
        yield from ("", f"### {section}", *_option_table([o for o in entries if o not in expert]))
        if expert:
            yield from ("", "For experiments:", *_option_table(expert))


def _option_table(entries: list[dict[str, Any]]) -> Iterator[str]:
    if entries:
        yield from ("", "| option | default | meaning |", "|---|---|---|")
        for entry in entries:
            choices = f" (`{'`, `'.join(entry['choices'])}`)" if entry["choices"] else ""
            flag = "--" + entry["name"].replace("_", "-")
            yield f"| `{flag}` | {default_text(entry['default'], entry['unit'])} | {_cell(entry['help'])}{choices} |"


def _value(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("%%", "%")


if __name__ == "__main__":
    for page, text in ((CLI, cli_page()), (ALGORITHMS, algorithms_page()), (ARCHITECTURE, architecture_page())):
        page.write_text(text, encoding="utf-8")
        print(f"Wrote {page}")

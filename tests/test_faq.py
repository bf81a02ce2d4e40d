# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/faq.md answers every message that people can get, and none that is no longer given."""

from __future__ import annotations

import ast
import re

from support.user_messages import GAP, ROOT, messages, template

FAQ = (ROOT / "docs" / "faq.md").read_text(encoding="utf-8")
LISTED = re.findall(r"^- “(.*)”$", FAQ, re.MULTILINE)


def test_every_listed_message_is_still_given() -> None:
    given = {text.strip() for text in messages()}
    assert len(LISTED) > 300 and len(set(LISTED)) == len(LISTED)
    assert [text for text in LISTED if text not in given] == [], "take them out of docs/faq.md"


def test_every_message_is_answered() -> None:
    missing = {text.strip(): where for text, where in messages().items() if text.strip() not in LISTED}
    assert missing == {}, "add them to docs/faq.md, below the question that answers them"


def test_every_question_has_an_answer_before_its_messages() -> None:
    for part in re.split(r"^### ", FAQ, flags=re.MULTILINE)[1:]:
        question, answer, *rest = part.split("\n\n")
        assert question.strip() and answer.strip() and not answer.startswith("-"), question
        assert rest and rest[0].startswith("- “"), question


def test_texts_are_read_with_gaps_for_values() -> None:
    def read(code: str) -> str | None:
        return template(ast.parse(code, mode="eval").body)

    assert read("f'{n} of {len(x)} photos ' f'are {a:.0%}'") == f"{GAP} of {GAP} photos are {GAP}"
    assert read("'The path {path!r} is {free:.1f} GB'") == f"The path {GAP} is {GAP} GB"
    assert read("'a' + b + 'c'") == f"a{GAP}c" and read("b") is None
    known = messages()
    assert known["This machine has no NVIDIA driver; install one if it has an NVIDIA GPU."].endswith("driver.py")
    assert any(text.startswith("The disk is full; free some space and") for text in known)

# SPDX-License-Identifier: GPL-3.0-or-later
"""Every text of the interface can be translated, and a translation reaches the user."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import string
import sys
from types import SimpleNamespace

import bpy
import pytest
from conftest import REPO
from layouts import draw
from support.user_messages import GAP, messages

from mgf_blender import preferences, properties, translations
from mgf_blender.common import options
from mgf_blender.common import text as text_module
from mgf_blender.common.errors import UserError
from mgf_blender.common.text import tr
from mgf_blender.jobs import engine_sentences
from mgf_blender.jobs.engine_messages import in_panel_terms, translate_message
from mgf_blender.jobs.status_label import _START, _TOOLS
from mgf_blender.prompts import files, operators, overlay, preview
from mgf_blender.prompts.panel import MGF_PT_masks, MGF_PT_prompts
from mgf_blender.reconstruct.panel import _NAME_LETTERS, MGF_PT_mark
from mgf_blender.scene_import.panel import MGF_PT_scene


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("extract_strings", REPO / "tools" / "extract_strings.py")
    module = importlib.util.module_from_spec(spec)
    path = list(sys.path)
    spec.loader.exec_module(module)
    sys.path[:] = path
    return module


@pytest.fixture
def german(addon, monkeypatch):
    """A German interface; builds of Blender without languages (the bpy module) get the dictionary by another way."""
    view = bpy.context.preferences.view
    if bpy.app.build_options.international:
        monkeypatch.setattr(view, "language", "de_DE")
        view.use_translate_interface = view.use_translate_tooltips = True
    else:
        known = translations.dictionary()["de_DE"]
        monkeypatch.setattr(text_module, "look_up", lambda text: known.get(("*", text), text))


def fields(text: str) -> list[tuple[str, str | None, str | None]]:
    """The placeholders of a text, each with how its value is written; their order may differ between languages."""
    found = [(name, spec, kind) for _, name, spec, kind in string.Formatter().parse(text) if name is not None]
    return sorted(found, key=repr)


def test_no_text_with_values_bypasses_translation(tool):
    assert tool.untranslatable() == []


def test_the_check_finds_a_bypass(tool, tmp_path, monkeypatch):
    (tmp_path / "panel.py").write_text(
        'layout.label(text=f"{n} cameras")\nlayout.label(text=f"{n:.2f}", translate=False)\n'
    )
    monkeypatch.setattr(tool, "ADDON", tmp_path)
    assert tool.untranslatable() == ["panel.py:1"]


def test_texts_are_complete_and_languages_fit(addon, tool):
    texts = {**tool.registered_texts(), **tool.source_texts(), **tool.schema_texts()}
    assert len(texts) > 350 and {"Preset", "Reconstruct Building", "{count} cameras"} <= set(texts)
    for path in sorted(translations.FOLDER.glob("*.json")):
        known = json.loads(path.read_text(encoding="utf-8"))
        # Options come and go with the engine; what nobody has translated yet may lag behind them.
        missing = {text for text, where in texts.items() if text not in known and where != "MGF_PG_options"}
        outdated = {text for text in set(known) - set(texts) if known[text]}
        assert not missing and not outdated, f"run tools/extract_strings.py {path.stem}"
        for english, text in known.items():
            assert not text or fields(text) == fields(english), (path.stem, english)


def test_placeholders_are_compared_with_their_formats():
    assert fields("{a:.1f} of {b!r}") == fields("{b!r}: {a:.1f}") != fields("{b}: {a:.1f}")
    assert fields("{a} and {a}") != fields("{a}") and fields("{a:.1f}") != fields("{a:.2f}")


def test_german_has_every_text_with_its_placeholders():
    known = json.loads((translations.FOLDER / "de_DE.json").read_text(encoding="utf-8"))
    assert [english for english, text in known.items() if not text.strip()] == []
    assert [english for english, text in known.items() if fields(text) != fields(english)] == []


def test_german_reaches_labels_values_and_errors(german, house, engine):
    assert translations.dictionary()["de_DE"][text_module.CONTEXT, "Import COLMAP Scene"] == "COLMAP-Szene importieren"
    assert tr("{count} cameras", count=12) == "12 Kameras"
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert "12 Kameras" in draw(MGF_PT_scene).said
    files.add_click(bpy.context.scene.mgf.photos[0], 1, 1, False, "building")
    assert "1 von 3 Fotos markiert" in draw(MGF_PT_mark).said
    error = UserError("The disk is full, '{path}' was not written; free some space and try again.", path="a {b}")
    assert str(error).startswith("Der Datenträger ist voll, „a {b}“")


def test_the_remark_on_lengths_names_what_the_job_lacks():
    """To press Georeference once more without control points would change nothing, so the remark asks for them."""
    source = (REPO / "mgf_engine" / "drawings" / "load.py").read_text(encoding="utf-8")
    texts = [n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    (said,) = (text for text in texts if "no true coordinates" in text)
    text = in_panel_terms(said)
    assert "give Georeference control points or scale bars" in text
    german = translations.dictionary()["de_DE"][text_module.CONTEXT, text]
    assert german.startswith("Der Auftrag hat keine wahren Koordinaten")


SAID = {
    "3 masks are weak and left out ('a.jpg', 'b {c}.jpg', ...); look at the contact sheet.": (
        "3 Masken sind schwach und bleiben weg ('a.jpg', 'b {c}.jpg', ...); den Kontaktbogen ansehen."
    ),
    "6 of 10 photos cannot be used, the first of them: The photo '/p/a.jpg' does not exist; replace the file or export "
    "the photo again.": (
        "6 von 10 Fotos sind unbrauchbar, das erste davon: Das Foto „/p/a.jpg“ gibt es nicht; die Datei ersetzen oder "
        "das Foto neu exportieren."
    ),
    "The photo 'a.jpg' is 40 x 30 pixels but its camera 30 x 40, as if it was turned since; use the photos the COLMAP "
    "model was made from.": (
        "Das Foto „a.jpg“ hat 40 x 30 Pixel, seine Kamera 30 x 40, als wäre es seither gedreht worden; die Fotos "
        "nehmen, aus denen das COLMAP-Modell entstand."
    ),
    "5% of the building has neither texture nor sparse points; the mesh is interpolated there. Closer photos, a higher "
    "--resolution or slanting light would help.": (
        "5% des Gebäudes haben weder Struktur noch Punkte; dort ist das Mesh interpoliert. Nähere Fotos, eine höhere "
        "„Auflösung“ oder Streiflicht würden helfen."
    ),
    "other photos contradict 31% of its points": "andere Fotos widersprechen 31% ihrer Punkte",
    "Nobody has translated this; run again with --resume.": "Nobody has translated this; press Resume.",
}


@pytest.mark.parametrize("said", SAID)
def test_messages_of_the_engine_are_shown_in_german_with_their_values(german, said):
    assert translate_message(in_panel_terms(said)) == SAID[said]


def test_why_a_mask_is_left_out_and_a_preview_failed_is_said_in_german(german, house, monkeypatch):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    photo = bpy.context.scene.mgf.photos[0]
    entry = {"score": 0.5, "used": False, "flag": "other photos contradict 31% of its points"}
    monkeypatch.setattr(overlay, "mask_entry", lambda scene, name: entry)
    assert "andere Fotos widersprechen 31% ihrer Punkte" in draw(MGF_PT_masks).said
    said = "The photo '/a.jpg' does not exist; replace the file or export the photo again."
    failed = SimpleNamespace(status=preview.FAILED, text=said)
    monkeypatch.setattr(preview, "newest", lambda scene, name: failed)
    assert photo.name and "Das Foto „/a.jpg“ gibt es nicht" in draw(MGF_PT_prompts).said


def test_translated_sentences_are_those_that_the_engine_says():
    """Whoever changes a message of the engine is told here; words that a value brings may stand in ours."""
    said = [in_panel_terms(text) for text, where in messages().items() if where.startswith("mgf_engine")]
    patterns = [re.compile(".*".join(map(re.escape, text.split(GAP)))) for text in said]
    for sentence in (*engine_sentences.FAILURES, *engine_sentences.WARNINGS):
        ours = re.sub(r"\{\w+\}", GAP, sentence)
        assert any(pattern.fullmatch(ours) for pattern in patterns), sentence


def test_parts_of_sentences_are_those_that_the_engine_says():
    sources = "".join(path.read_text(encoding="utf-8") for path in (REPO / "mgf_engine").rglob("*.py"))
    kinds = "JPEG, PNG, TIFF, WebP or BMP"
    for reason in engine_sentences.REASONS:
        assert all(text in sources for text in reason.split("{share}")), reason
    for part in engine_sentences.PARTS:
        assert part.replace(kinds, "{_KINDS}") in sources and kinds in sources, part


def test_english_stays_english_and_unknown_texts_pass(addon):
    assert tr("{count} cameras", count=3) == "3 cameras" and tr("100 % {") == "100 % {"


def test_damaged_or_empty_dictionaries_are_left_out(tmp_path):
    (tmp_path / "fr_FR.json").write_text("{")
    (tmp_path / "it_IT.json").write_text('{"Cancel": "Annulla", "Open": ""}')
    assert translations.dictionary(tmp_path) == {
        "it_IT": {("*", "Cancel"): "Annulla", (text_module.CONTEXT, "Cancel"): "Annulla"}
    }


def labels() -> list[tuple[str, int]]:
    """Texts that panels of the sidebar show on one line, beside an icon or a button: text and where it stands."""
    modules = (
        "jobs/import_status",
        "jobs/status_label",
        "prompts/panel",
        "reconstruct/panel",
        "results/panel",
        "scene_import/panel",
    )
    found = []
    for name in modules:
        imported = ast.parse((REPO / "mgf_blender" / f"{name}.py").read_text(encoding="utf-8"))
        calls = [n for n in ast.walk(imported) if isinstance(n, ast.Call) and getattr(n.func, "attr", "") == "label"]
        texts = [k.value for n in calls for k in n.keywords if k.arg == "text"]
        texts = [t.args[0] if isinstance(t, ast.Call) and t.args else t for t in texts]
        found += [(t.value, t.lineno) for t in texts if isinstance(t, ast.Constant) and isinstance(t.value, str)]
    return found


def test_no_label_of_one_line_is_cut_off():
    """A sidebar of the default width has room for 34 letters; what is longer goes through ``draw_sentence``."""
    known = translations.dictionary()["de_DE"]
    found = labels()
    assert len(found) >= 2
    for text, line in found:
        assert max(len(text), len(known.get(("*", text), ""))) <= 30, (text, line)


def test_blenders_own_words_do_not_take_the_place_of_ours(addon):
    """Blender's dictionary comes first where a text has no context of ours: a control point was one of a curve."""
    found = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("MGF_")]
    shown = [kind for kind in found if issubclass(kind, bpy.types.Operator | bpy.types.Panel)]
    assert len(shown) > 50
    assert [k.__name__ for k in shown if k.bl_rna.translation_context != text_module.CONTEXT] == []
    rnas = [kind.bl_rna for kind in [*properties.CLASSES, preferences.MGF_Preferences]]
    rnas += [getattr(bpy.ops.mgf, k.bl_idname.split(".")[1]).get_rna_type() for k in shown if hasattr(k, "run")]
    foreign = [
        (rna.identifier, prop.identifier)
        for rna in rnas
        for prop in rna.properties
        if prop.is_runtime and not prop.is_hidden and prop.translation_context != text_module.CONTEXT
    ]
    assert foreign == []


def test_lookups_ask_in_our_context_first(addon, monkeypatch):
    blender = {("Level", "*"): "Stufe", ("Add", "*"): "Hinzufügen", ("Level", "MGF"): "Waagerecht"}
    blender |= {("Mesh", "*"): "Masche", ("Mesh", "MGF"): "Mesh"}
    asked = SimpleNamespace(pgettext_iface=lambda text, context="*": blender.get((text, context), text), locale="de_DE")
    monkeypatch.setattr(text_module, "bpy", SimpleNamespace(app=SimpleNamespace(translations=asked)))
    assert [text_module.look_up(t) for t in ("Level", "Add", "Else")] == ["Waagerecht", "Hinzufügen", "Else"]
    assert ("MGF", "Level") in translations.dictionary()["de_DE"]
    assert text_module.look_up("Mesh") == "Mesh"  # which our dictionary leaves as it is: the heading said "Masche"
    asked.locale = "fr_FR"  # of which we have no dictionary: Blender's word is better than none
    assert text_module.look_up("Mesh") == "Masche"


def test_tooltips_that_say_what_a_button_does_here_are_translated(german):
    said = [operators.MGF_OT_next_photo.description(bpy.context, SimpleNamespace(step=step)) for step in (-1, 1)]
    assert said == ["Zum vorigen Foto gehen", "Zum nächsten Foto gehen"]


#: What a sidebar of the default width has room for, in pixels at interface scale 1, as seen in Blender 5.2: a name
#: before its value, a long one that the panel gives more of the width, one behind its tick, and the line of a progress
#: bar.
NAME, LONG_NAME, TICK, BAR = 86, 100, 114, 182


def width(text: str) -> float:
    """Of a text as panels draw it, pixels at interface scale 1."""
    import blf  # of the bpy package, which must come first

    blf.size(0, 11)
    return blf.dimensions(0, text)[0]


def test_names_of_options_have_room():
    german = translations.dictionary()["de_DE"]
    known = {english: text for (_, english), text in german.items()}
    cut = set()
    for name, option in options.OPTIONS.items():
        title = options.title(name)
        for text in {title, known.get(title, title)} - {known["Crop Box"], "Crop Box"}:
            name_room = NAME if len(text) <= _NAME_LETTERS else LONG_NAME
            cut |= {text} if width(text) > (TICK if option["type"] == "bool" else name_room) else set()
    assert cut == set()


def test_progress_bars_say_how_long_it_takes_still():
    german = translations.dictionary()["de_DE"]
    known = {english: text for (_, english), text in german.items()}
    long = {"Rendering and reporting", known["Rendering and reporting"]}  # which takes seconds, and gives way
    for stage in {*options.STAGES.values(), *_START.values(), *_TOOLS.values()} - long:
        for text, left in ((stage, "{stage}, {time} left"), (known[stage], known["{stage}, {time} left"])):
            assert width(left.format(stage=text, time="59 min")) <= BAR, text

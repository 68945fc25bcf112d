"""Each sentence that promises something about a robot's safety names its tests, see safety_sentences.yaml."""

import ast
import re

import pytest
import yaml

from vb_testing import TOP

TABLE = yaml.safe_load((TOP / "test" / "safety_sentences.yaml").read_text(encoding="utf-8"))
FILES, EXPLAINS = TABLE.pop("files"), TABLE.pop("explains")
# the parts of each page that make promises: (beginning, end)
SECTIONS = {
    "README.md": [("- **When in doubt, the robot", "\n## ")],
    "docs/explanation/robots.md": [("## What is connected\n", "## Robot types"), ("## Borders and loc", "## Limits")],
}


def sentences_of(page):
    """Splits these parts of a page into sentences and table rows."""
    whole = (TOP / page).read_text(encoding="utf-8")
    text = ""
    for begin, end in SECTIONS[page]:
        start = whole.index(begin)
        text += re.sub(r"^#.*$", "", whole[start : whole.index(end, start + 3)], flags=re.M) + "\n\n"
    sentences = []
    for block in re.split(r"\n\s*\n", text):
        if block.lstrip().startswith("|"):
            sentences += [row.strip("| ") for row in block.strip().splitlines()[2:]]
        else:
            for item in re.split(r"^- ", block, flags=re.M):
                item = " ".join(item.split())
                sentences += re.split(r"(?<=[.:])\s+(?=[A-Z*`\[])", item) if item else []
    return sentences


@pytest.mark.parametrize("page", SECTIONS)
def test_each_sentence_has_a_test_or_promises_nothing(page):
    sentences = sentences_of(page)
    assert len(sentences) >= 3
    known = [*TABLE[page], *EXPLAINS]
    for sentence in sentences:
        assert sum(sentence.startswith(begin) for begin in known) == 1, f"no test for: {sentence}"
    for begin in TABLE[page]:
        assert any(sentence.startswith(begin) for sentence in sentences), f"{page} does not say any more: {begin}"


def test_what_promises_nothing_is_still_there():
    everything = [sentence for page in SECTIONS for sentence in sentences_of(page)]
    assert [begin for begin in EXPLAINS if not any(sentence.startswith(begin) for sentence in everything)] == []


def test_each_test_is_there():
    named = {tuple(test.split()) for rows in TABLE.values() for tests in rows.values() for test in tests}
    assert len(named) > 40
    assert all(tests for rows in TABLE.values() for tests in rows.values())
    for key, path in FILES.items():
        tree = ast.parse((TOP / path).read_text(encoding="utf-8"))
        defined = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        assert {test for file, test in named if file == key} <= defined, path

"""The sentences that people read or hear, by code and language.

Messages carry a code and values. A sentence is looked up here, in the language of the person who reads it.
languages/<language>/<topic>.yaml maps each code to one sentence with the values' names in braces:

    page_removed: "{border} was removed."

Words that differ by language are passed as a code, in a value whose name says so: who_code = "the_robot" gives {who} the
text of this code. All other values are texts, perhaps written by people, and never read as codes. A code's text may
contain the sentence's other values, and is capitalised where it begins the sentence. The values border and borders are
names of borders, see `border_name`.

No program parses a sentence.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any, Dict, List, Mapping

import yaml

ENGLISH = "en"
LANGUAGES_FOLDER = Path(__file__).resolve().parent / "languages"
_FIELD = re.compile(r"\{(\w+)\}")
_CODE = "_code"  # ends the name of a value that is a code
# a name that the border database gave: alone, in quotes or in a list of names
_UNNAMED = re.compile(r"(?:^|(?<=^')|(?<=, ))(border|wall) (\d+)(?=$|'$|, )")


def languages() -> List[str]:
    """Lists the available languages, by their two-letter codes."""
    return sorted(path.name for path in LANGUAGES_FOLDER.iterdir() if path.is_dir())


@functools.lru_cache(maxsize=None)
def catalog(language: str = ENGLISH) -> Dict[str, str]:
    """Reads every code's sentence in one language, from all of its files. Raises ValueError if two have the same code."""
    by_code: Dict[str, str] = {}
    for path in sorted((LANGUAGES_FOLDER / language).glob("*.yaml")):
        for code, sentence in (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).items():
            if code in by_code:
                raise ValueError(f"{path}: {code} has a sentence in another file already")
            by_code[code] = sentence
    return by_code


def words_of_name(name: str) -> str:
    """Returns the words of a code or a name: "define_border" is "define border"."""
    return name.replace("_", " ")


def robot_values(*names: str, key: str = "who") -> Dict[str, str]:
    """Returns the value that names robots in a sentence as {key}. An empty name means the only robot."""
    return {key: ", ".join(names)} if any(names) else {key + _CODE: "the_robot"}


def border_name(name: str, language: str = ENGLISH) -> str:
    """Returns the names of one or several borders as people read them: a name that nobody chose is translated."""
    return _UNNAMED.sub(lambda found: translate(f"unnamed_{found[1]}", {"number": found[2]}, language), name)


def translate(code: str, values: Mapping[str, Any] = {}, language: str = ENGLISH, default: str = "") -> str:
    """Returns the sentence for a code; in English where the language has none.

    Args:
        values: the values in the sentence, by their names: texts, or codes if the name ends in "_code".
        default: returned for an unknown code, for instance a message's own English sentence; if that is empty too,
            the code's words are returned.
    """
    sentence = catalog(language).get(code) or catalog(ENGLISH).get(code)
    if sentence is None:
        return default or words_of_name(code)

    def text_of(field: "re.Match[str]") -> str:
        name = field[1]
        if name + _CODE in values:
            other_values = {other: value for other, value in values.items() if other != name + _CODE}
            text = translate(values[name + _CODE], other_values, language)
            begins_sentence = field.start() == 0
            return text[:1].upper() + text[1:] if begins_sentence else text
        text = str(values.get(name, f"({name})"))  # a sentence that lacks a value can still be shown
        return border_name(text, language) if name in ("border", "borders") else text

    return _FIELD.sub(text_of, sentence)

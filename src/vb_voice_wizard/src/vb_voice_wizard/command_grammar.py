"""What people can say: the grammar (which phrases mean which command) and the dictionary (how words sound)."""
from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterable, List, Tuple

import yaml

from vb_core.errors import ParameterError

from vb_voice_wizard.interaction import COMMANDS

_MOST_VARIANTS = 64


@dataclass(frozen=True)
class Phrase:
    """One way to say a command: its words, each a list of phones."""

    command: str
    text: str
    words: Tuple[Tuple[str, ...], ...]


def config_folder() -> Path:
    """The package's config/voice, in the source tree or where the workspace is installed."""
    source = Path(__file__).resolve().parents[2] / "config" / "voice"
    if source.is_dir():
        return source
    for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
        installed = Path(prefix) / "share" / "vb_voice_wizard" / "config" / "voice"
        if prefix and installed.is_dir():
            return installed
    return source


def find(key: str, value: str, default: str) -> Path:
    """The file that a parameter names; an empty one names the package's own.

    Raises:
        ParameterError: if there is no such file.
    """
    path = Path(os.path.expanduser(value)) if value else config_folder() / default
    if not path.is_file():
        raise ParameterError(key, f"there is no file {path}")
    return path


def read_grammar(path: Path) -> Dict[str, List[str]]:
    """Reads a grammar: a YAML mapping from each command to the list of its phrases.

    Raises:
        ParameterError: for a file that is not such a mapping, an unknown command, one without a phrase, or
            a phrase that two commands share.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError("grammar", f"cannot read {path}: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or not content:
        raise ParameterError("grammar", f"{path}: expected commands and their phrases")
    grammar: Dict[str, List[str]] = {}
    owner: Dict[str, str] = {}
    for command, phrases in content.items():
        if command not in COMMANDS:
            raise ParameterError("grammar", f"{path}: unknown command {command!r}; known are {', '.join(COMMANDS)}")
        if not isinstance(phrases, list) or not phrases or not all(isinstance(p, str) and p.split() for p in phrases):
            raise ParameterError("grammar", f"{path}: {command} needs a list of phrases")
        grammar[command] = [" ".join(phrase.lower().split()) for phrase in phrases]
        for phrase in grammar[command]:
            if owner.setdefault(phrase, command) != command:
                raise ParameterError("grammar", f"{path}: {phrase!r} means both {owner[phrase]} and {command}")
    return grammar


def read_dictionary(path: Path, wanted: Iterable[str], phones: Iterable[str]) -> Dict[str, List[Tuple[str, ...]]]:
    """Reads the wanted words of a dictionary in CMU's form: "border B AO R D ER", variants as "border(2)".

    Raises:
        ParameterError: for a phone that the model does not have, naming the word.
    """
    words, known = set(wanted), set(phones)
    found: Dict[str, List[Tuple[str, ...]]] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError("dictionary", f"cannot read {path}: {error}") from error
    for line in lines:
        head, _, tail = line.partition(" ")
        word = head.split("(")[0].lower()
        if word not in words or head.startswith("#"):
            continue
        pronunciation = tuple(tail.split("#")[0].split())
        wrong = [phone for phone in pronunciation if phone not in known]
        if wrong or not pronunciation:
            raise ParameterError("dictionary", f"{path}: word {word!r} has an unknown phone: {' '.join(wrong) or '(none)'}")
        found.setdefault(word, []).append(pronunciation)
    return found


def phrases(
    grammar: Dict[str, List[str]], wake_word: str, dictionaries: Iterable[Path], phones: Iterable[str]
) -> List[Phrase]:
    """Every phrase in every pronunciation.

    Args:
        grammar: from read_grammar.
        wake_word: said before every command; empty for none.
        dictionaries: searched in this order; the first that has a word says how it sounds.
        phones: of the acoustic model.

    Raises:
        ParameterError: names the words that no dictionary has.
    """
    spoken = [(command, f"{wake_word.lower()} {text}".split()) for command, texts in grammar.items() for text in texts]
    wanted = {word for _, words in spoken for word in words}
    sounds: Dict[str, List[Tuple[str, ...]]] = {}
    files = list(dictionaries)
    for path in files:
        for word, variants in read_dictionary(path, wanted - set(sounds), phones).items():
            sounds[word] = variants
    missing = sorted(wanted - set(sounds))
    if missing:
        where = ", ".join(str(path) for path in files)
        raise ParameterError("dictionary", f"no pronunciation of {', '.join(map(repr, missing))}; add it to {where}")
    result = []
    for command, words in spoken:
        for variant in itertools.islice(itertools.product(*(sounds[word] for word in words)), _MOST_VARIANTS):
            result.append(Phrase(command, " ".join(words), variant))
    return result

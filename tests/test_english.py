"""The words of the program: documents, messages, docstrings and comments in plain English."""

import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("app", "blueprints", "loaders", "algorithms/base", "algorithms/maps", "algorithms/poses")
FOLDERS += ("algorithms/scan", "algorithms/truth")
ODD = re.compile(
    r"\b(tells?|told|stands?|asks|asked|says|said|of which|what is|what stands|goes on|"
    r"there is none|nobody|whoever|so many)\b",
    re.IGNORECASE,
)
"""Files, walls and settings do not speak: the program detects, computes, writes, prints, requires.

"Of which" and "what is" hide the noun that a reader needs.
"""


def prose(path: Path) -> list[tuple[int, str]]:
    """Lines of a document, or strings and comments of a module, each with its line number."""
    text = path.read_text("utf-8")
    if path.suffix == ".md":
        return list(enumerate(text.splitlines(), 1))
    words = (tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", None))
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [(token.start[0], token.string) for token in tokens if token.type in words]


FILES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FILES += sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_words_are_plain(path: Path) -> None:
    found = [(line, odd.group()) for line, text in prose(path) for odd in ODD.finditer(text)]
    assert not found

"""Hook of mkdocs: the site shows the pages as GitHub does.

A link from a page to a file outside of docs/ becomes that file's path, which the site cannot show; on GitHub it leads to
the file. What belongs to an item of a list is indented by four spaces, and an item of several paragraphs ends with an
empty line, as Python-Markdown wants it.
"""

import posixpath
import re

_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)(?:#[^)\s]*)?\)")

_ITEM = re.compile(r"(?:[-*]|\d+\.) +")


def name_outside_files(markdown: str, page: str) -> str:
    """Replaces each link that leaves docs/ by its text and the file's path in the repository.

    Args:
        markdown: text of the page.
        page: its path below docs/.
    """

    def name(match: "re.Match") -> str:
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), match.group(2)))
        if path.startswith("docs/"):
            return match.group(0)
        text = match.group(1).strip("`")
        return f"`{path}`" if path.endswith(text) or text.rstrip("/") == path else f"{match.group(1)} (`{path}`)"

    return _LINK.sub(name, markdown)


def indent_lists(markdown: str) -> str:
    """Indents what belongs to an item of a list by four spaces per level; in the pages it is in line with the item's text."""
    lines, texts, fence, parts = [], [], False, False  # texts: the column of each open item's text
    for line in markdown.split("\n"):
        content = line.lstrip()
        indent = len(line) - len(content)
        while content and texts and indent < texts[-1]:
            texts.pop()
        beyond = indent - (texts[-1] if texts else 0)
        shown = " " * (4 * len(texts) + beyond) + content if content else ""
        fence ^= content.startswith("```")
        item = _ITEM.match(content)
        if item and beyond < 4 and not fence:  # further in, it is code
            lines += [""] if parts and lines[-1] else []  # after an item of several paragraphs
            texts.append(indent + len(item.group()))
        parts = not item and (parts or not content)
        lines.append(shown)
    return "\n".join(lines)


def on_page_markdown(markdown, page, **_):
    """Edits a page before mkdocs turns it into HTML."""
    return indent_lists(name_outside_files(markdown, page.file.src_uri))

"""Hook of mkdocs: a link from a page to a file outside of docs/ becomes that file's path, which the site cannot show.

On GitHub the same links lead to the files.
"""

import posixpath
import re

_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)(?:#[^)\s]*)?\)")


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


def on_page_markdown(markdown, page, **_):
    """Edits a page before mkdocs turns it into HTML."""
    return name_outside_files(markdown, page.file.src_uri)

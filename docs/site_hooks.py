"""Lets the pages link to files outside `docs/`: the site gets copies of them.

Pages link as they would in the repository (`../problems/peer_cap.yaml`), so that links work there and on the site.
Changelog, contributing and architecture become pages; other files are copied into `files/`.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md", "ARCHITECTURE.md": "architecture.md"}
LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that stand outside `docs/`."""
    root = Path(config.docs_dir).parent
    for name, uri in PAGES.items():
        files.append(File.generated(config, uri, content=_moved(root / name)))
    for page in files.documentation_pages():
        for target in _outside(page.src_uri, page.content_string):
            uri = f"files/{target}"
            if (root / target).is_file() and files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(root / target)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Points links that lead outside `docs/` at the copies."""
    here = page.file.src_uri

    def replaced(match: re.Match[str]) -> str:
        target = _target(here, match[2])
        if target is None:
            return match[0]
        found = PAGES.get(target, f"files/{target}")
        return f"{match[1]}{posixpath.relpath(found, posixpath.dirname(here) or '.')}{match[3] or ''}{match[4]}"

    return LINK.sub(replaced, markdown)


def _moved(source: Path) -> str:
    """A page of the repository's root as if it stood in `docs/`."""

    def replaced(match: re.Match[str]) -> str:
        link = match[2]
        if ":" in link:
            return match[0]
        link = link.removeprefix("docs/") if link.startswith("docs/") else f"../{link}"
        return f"{match[1]}{link}{match[3] or ''}{match[4]}"

    return LINK.sub(replaced, source.read_text(encoding="utf-8"))


def _outside(here: str, text: str) -> set[str]:
    """Files outside `docs/` that a page links to, counted from the root; those that became pages left out."""
    targets = (_target(here, match[2]) for match in LINK.finditer(text))
    return {target for target in targets if target is not None and target not in PAGES}


def _target(here: str, link: str) -> str | None:
    """Where a link leads, counted from the root; None where it stays in `docs/` or leads to the web."""
    if ":" in link:
        return None
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(here), link))
    return None if path == "docs" or path.startswith("docs/") else path

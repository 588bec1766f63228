# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What the documentation site (``mkdocs.yml``) has beside the pages of doc/: pages from elsewhere.

MkDocs calls the functions here while it builds. README.md becomes the first page; links to files
that are pages lead to these pages, so that the same text serves on a disk and on the site.
"""

from pathlib import Path, PurePosixPath
import posixpath
import re

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
# Pages of the site, by the files outside doc/ that they are made of.
BORROWED = {'README.md': 'index.md', 'CONTRIBUTING.md': 'contributing.md',
            'benchmark/README.md': 'benchmarks.md'}
LINK = re.compile(r'(\]\()([^)\s#:]+\.\w+)(?=[)#])')


def on_files(files, config):
    """Add the borrowed pages."""
    for source, page in BORROWED.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        files.append(File.generated(config, page, content=relinked(text, source)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Let links of a page of doc/ to borrowed ones lead there."""
    if page.file.src_uri in BORROWED.values():
        return markdown
    return relinked(markdown, posixpath.join('doc', page.file.src_uri))


def relinked(text, source):
    """Return the text of a file of the checkout with its links as they are on the site."""
    return LINK.sub(lambda found: found[1] + _on_site(found[2], source), text)


def _on_site(target, source):
    """Return a link to where the site has a file of the checkout."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
    if path in BORROWED:
        return BORROWED[path]
    inside = PurePosixPath(path)
    return str(inside.relative_to('doc')) if inside.parts[0] == 'doc' else target

# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What the documentation site (``mkdocs.yml``) has beside the pages of doc/: pages from elsewhere.

MkDocs calls the functions here while it builds. README.md becomes the first page; links to files
that are pages lead to these pages, so that the same text serves on a disk and on the site. The
shipped machines that can be simulated in a browser have pages of their own.
"""

from html import escape
from pathlib import Path, PurePosixPath
import posixpath
import re

from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.scene.loading import load_scene, scene_names
from closedloop_dynamics.view.library import picture
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.page import editor_page, standalone_page
from closedloop_dynamics.view.standalone import METHOD, standalone
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
# Pages of the site, by the files outside doc/ that they are made of.
BORROWED = {'README.md': 'index.md', 'CONTRIBUTING.md': 'contributing.md',
            'benchmark/README.md': 'benchmarks.md'}
# Where the gallery is, and the pages of machines that are simulated in the browser.
GALLERY, LIVE, EDITOR, MACHINES = 'live.md', 'live', 'editor', '<!-- live machines -->'
LINK = re.compile(r'(\]\()([^)\s#:]+\.\w+)(?=[)#])')


def on_files(files, config):
    """Add the borrowed pages, and those of live machines with their pictures."""
    files.append(File.generated(
        config, f'{LIVE}/{EDITOR}.html', content=editor_page('Draw and simulate', METHOD)))
    for name in scene_names():
        scene = load_scene(name)
        try:
            page = standalone_page(name, *standalone(scene, own_motion(scene)))
        except SimulationError:
            # It has no code of this kind.
            continue
        for ending, content in (('html', page), ('svg', picture(scene))):
            files.append(File.generated(config, f'{LIVE}/{name}.{ending}', content=content))
    for source, page in BORROWED.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        files.append(File.generated(config, page, content=relinked(text, source)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Let links of a page of doc/ to borrowed ones lead there; fill the gallery."""
    if page.file.src_uri in BORROWED.values():
        return markdown
    if page.file.src_uri == GALLERY:
        markdown = markdown.replace(MACHINES, _cards(files))
    return relinked(markdown, posixpath.join('doc', page.file.src_uri))


def _cards(files):
    """Return the pictures of the live machines, with links to their pages."""
    names = [name for name in scene_names() if f'{LIVE}/{name}.html' in files.src_uris]
    cards = (f'<a href="{LIVE}/{name}.html"><img alt="" src="{LIVE}/{name}.svg"><b>{name}</b>'
             f'<span>{escape(load_scene(name).description)}</span></a>' for name in names)
    return f'<div class="machines">{"".join(cards)}</div>'


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

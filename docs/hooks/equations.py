"""Equations: what the pages write in LaTeX is drawn into the page, in the colour of its text.

`pymdownx.arithmatex` finds them. They are drawn while the site is built, so that a reader needs no network, no
script and no font.
"""

from __future__ import annotations

import html
import logging
import re
import xml.etree.ElementTree as ET
from typing import Any

import ziafont
import ziamath

_LOG = logging.getLogger("mkdocs.hooks.equations")
_FOUND = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_POINTS_PER_EM = 24.0
#: Letters of STIX Two Math are smaller than those of the page's fonts.
_SCALE = 1.1

ziafont.config.svg2 = (
    False  # Each equation has its glyphs; shared ones hide with the equation that holds them.
)


def draw(latex: str, inline: bool) -> str:
    """Draw an equation.

    Args:
        latex: what stands between the dollars.
        inline: whether it stands in a line of text.

    Returns:
        An `svg` element, sized in em, its baseline on the text's.

    Raises:
        ValueError: it is no LaTeX, or has a command that is not known.
    """
    try:
        drawn = ziamath.Latex(latex, size=_POINTS_PER_EM, inline=inline, color="currentColor")
        unknown = re.search(r"\\\w*", "".join(ET.fromstring(drawn.mathmlstr()).itertext()))
        picture = drawn.svgxml()
    except Exception as error:
        raise ValueError(f"cannot be drawn: {latex} ({error!r})") from error
    if unknown is not None:
        raise ValueError(f"unknown command {unknown[0]} in {latex}")
    em = _SCALE / _POINTS_PER_EM
    width, height = (em * float(picture.get(side, "0")) for side in ("width", "height"))
    bottom = em * (sum(float(number) for number in picture.get("viewBox", "").split()[1::2]))
    picture.attrib |= {
        "width": f"{width:.3f}em",
        "height": f"{height:.3f}em",
        "style": f"vertical-align: {-bottom:.3f}em",
        "role": "img",
        "aria-label": latex.strip(),
    }
    return ET.tostring(picture, encoding="unicode")


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Put the drawings where `pymdownx.arithmatex` marked equations; one that cannot be drawn is a warning."""

    def drawn(found: re.Match[str]) -> str:
        try:
            picture = draw(html.unescape(found[2]), found[1] == "span")
        except ValueError as error:
            _LOG.warning(f"{page.file.src_path}: equation {error}")
            return found[0]
        return f'<{found[1]} class="equation">{picture}</{found[1]}>'

    return _FOUND.sub(drawn, content)

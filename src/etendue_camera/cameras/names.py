"""Names of cameras and lenses as people type them.

In:  a typed text, and all existing names.
Out: the matching name, or the nearest names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from etendue.errors import RequestError, nearest

_BRANDS = {
    "nikon corporation": "Nikon",
    "canon inc.": "Canon",
    "om digital solutions": "OM System",
    "olympus imaging corp.": "Olympus",
    "olympus corporation": "Olympus",
    "pentax corporation": "Pentax",
    "ricoh imaging company, ltd.": "Ricoh",
    "eastman kodak company": "Kodak",
    "leica camera ag": "Leica",
    "sony": "Sony",
    "fujifilm": "Fujifilm",
    "samsung techwin": "Samsung",
}
LONGEST = 200  # characters; a longer text matches nothing
_MARK = re.compile(r"\b(?:mark|mk)[ .-]*(iii|ii|iv|vi|v|\d)\b")
# Sony's model code and trade name: ILCE-7RM2 is sold as a7R II.
_ALPHA = re.compile(r"\b(?:a|alpha ?)(\d+[a-z]*)(?:[ -]+(iii|ii|iv|vi|v)\b)?")
_ROMAN = {"ii": "2", "iii": "3", "iv": "4", "v": "5", "vi": "6"}


def brand(maker: str) -> str:
    """Return the usual name of a maker: Nikon for NIKON CORPORATION."""
    found = _BRANDS.get(maker.casefold())
    return found or (maker.title() if maker.isupper() and len(maker) > 4 else maker)


def full_name(maker: str, model: str) -> str:
    """Return maker and model as one name, with the maker once."""
    own = brand(maker)
    for start in (own, maker):
        if start and model.casefold().startswith(start.casefold() + " "):
            return f"{own} {model[len(start) + 1 :]}"
    return f"{own} {model}".strip()


def plain(name: str) -> str:
    """Return a name without case, spaces and punctuation, and with its generation in digits: 'Canon EOS R5 Mark II' and
    'canon eos-r5m2' become equal.
    """
    text = _MARK.sub(lambda found: f"m{_ROMAN.get(found[1], found[1])}", name.casefold().replace("α", "alpha"))
    text = _ALPHA.sub(lambda found: f"ilce{found[1]}{f'm{_ROMAN[found[2]]}' if found[2] else ''}", text)
    parts = [_ROMAN.get(part, part) for part in re.split(r"[^a-z0-9.+]+", text) if part]
    return re.sub(r"(?<!\d)\.|\.(?!\d)", "", "".join(parts))


def words(name: str) -> list[str]:
    """Return the words and numbers of a text, without case."""
    return [word for word in re.split(r"[^a-z0-9.+]+", name.casefold()) if word.strip(".")]


def matching(text: str, names: Iterable[str]) -> list[str]:
    """Return the names that contain every word of a text, anywhere and in any order."""
    wanted = words(text)
    return [name for name in names if all(word in name.casefold() for word in wanted)]


def meant(text: str, names: Iterable[str], what: str, listed: str) -> str:
    """Return the one name that matches a text: a name that is equal except for case and punctuation, otherwise the only
    name with all words of the text.

    Raises
    ------
    RequestError
        If no name matches (the message gives the nearest names), or several do (it gives the first few).
    """
    known = list(dict.fromkeys(names))
    if len(text) > LONGEST:
        raise RequestError(f"no {what} has a name of {len(text)} characters; {listed} lists them")
    if text in known:
        return text
    own = plain(text)
    equal = [name for name in known if plain(name) == own]
    if len(equal) == 1:
        return equal[0]
    # 'D800' is a part of 'D800E': names that contain each typed word as a whole word come first
    found = [name for name in known if own and own in plain(name)] or matching(text, known)
    whole = [name for name in found if set(words(text)) <= set(words(name))]
    found = whole if len(whole) == 1 else found
    if len(found) == 1:
        return found[0]
    if found:
        shown = ", ".join(repr(name) for name in found[:6]) + (f" and {len(found) - 6} more" if len(found) > 6 else "")
        raise RequestError(f"the {what} {text!r} may be {shown}; write more of the name")
    hint = nearest(text, known) or nearest(text.casefold(), [name.casefold() for name in known])
    raise RequestError(f"unknown {what} {text!r}{hint}; {listed} lists them")

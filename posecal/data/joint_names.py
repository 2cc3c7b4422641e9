"""Joint names: one joint in every spelling, read list by list.

The field spells one joint in several ways (``right_ankle``, ``RAnkle``, ``R.Foot``), and one word means several joints:
Human3.6M's foot is the ankle, SMPL has an ankle and a foot. So names are read by lists: where a list has both, each is
a joint of its own. Two lists are matched by what their names mean; where that is ambiguous, both spellings are named.
The user's own spelling is what reports print.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from itertools import permutations

from posecal.errors import first_few

Names = tuple[str, ...]

# Human3.6M's name: its spellings without case, separators and sides written out; the most specific first.
_SPELLINGS: dict[str, tuple[str, ...]] = {
    "Hip": ("hip", "pelvis", "midhip", "hips", "hipcenter", "bodycenter", "root"),
    "Spine": ("spine",),
    "Thorax": ("thorax", "neck"),
    "UpperNeck": ("upperneck",),
    "Neck/Nose": ("necknose",),
    "Head": ("headtop", "head", "headbase"),
    **{f"{s.upper()}Foot": (f"{s}ankle", f"{s}foot") for s in "lr"},
    **{f"{s.upper()}{part}": (f"{s}{part.lower()}",) for s in "lr" for part in ("Hip", "Knee")},
    **{f"{s.upper()}{part}": (f"{s}{part.lower()}",) for s in "lr" for part in ("Shoulder", "Elbow", "Wrist")},
}
_MEANINGS = {spelt: name for name, spellings in _SPELLINGS.items() for spelt in spellings}

_OF_SITES = {"neck": "thorax", "head": "necknose", "site": "headtop", "siteofhead": "headtop", "spine1": "spine"}
_BONES = {"upleg": "hip", "leg": "knee", "shoulder": "clavicle", "arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
_OF_BONES = {f"{s}{bone}": f"{s}{joint}" for s in "lr" for bone, joint in _BONES.items()}
# Words that a list must have, words that it must not have, and what its words mean then. In Human3.6M's own lists, and
# in those of motion capture, a bone gives its name to the joint where it begins: without a top, the head is its base,
# as SMPL's is. A nose beside eyes is a nose; between neck and head it is Human3.6M's neck/nose.
_CONVENTIONS: tuple[tuple[set[str], set[str], Mapping[str, str]], ...] = (
    ({"neck", "head", "site"}, {"thorax"}, {**_OF_SITES, "spine": "spine0"}),
    ({"neck", "head", "siteofhead"}, {"thorax"}, {**_OF_SITES, "spine": "spine0"}),
    ({"rupleg", "lupleg"}, set(), _OF_BONES),
    ({"spine", "thorax", "neck", "head"}, {"upperneck", "necknose", "nose", "headtop"}, {"neck": "necknose"}),
    ({"spine", "thorax", "neckbase", "head"}, {"upperneck", "necknose", "nose"}, {"neckbase": "necknose"}),
    *(
        ({neck, "nose", head}, {other, "upperneck", "necknose", "leye", "lear"}, {"nose": "necknose"})
        for neck, other in (("neck", "thorax"), ("thorax", "neck"))
        for head in ("head", "headtop")
    ),
    ({"necknose", "head"}, {"headtop"}, {"head": "headtop"}),
    ({"spine1", "neck", "head"}, {"thorax", "headtop", "necknose"}, {"head": "headbase"}),
)
_CLEAR = frozenset(("lankle", "rankle", "headtop", "thorax", "necknose"))
"""Spellings that mean one joint even beside a list that has two of the kind."""

_UNCLEAR: dict[str, tuple[str, ...]] = {"neck": ("upperneck",), "headbase": ("headtop", "head", "necknose")}
"""Spellings that may mean another joint, or none, where the other list has these and not the spelling itself."""

_LOOSE = ("Thorax", "Head")
"""Joints that data sets place differently under their several names."""

MOST_NAMED = 200
"""Lists of more joints are meshes: their names are not compared with those of a skeleton."""


@cache
def letters(name: str) -> str:
    """Give a name without case and separators, with its side as the first letter.

    Examples
    --------
    >>> letters("Right_Ankle"), letters("wrist left"), letters("R.Foot")
    ('rankle', 'lwrist', 'rfoot')
    """
    plain = re.sub(r"[\W_]", "", name.lower())
    plain = re.sub(r"^(right|left)", lambda side: side[0][0], plain)
    return re.sub(r"^(.+)(right|left)$", lambda word: word[2][0] + word[1], plain)


@cache
def _meanings(names: Names) -> tuple[str, ...]:
    """Give the names' letters, translated where the list as a whole follows another convention."""
    plain = tuple(map(letters, names))
    for needed, absent, translated in _CONVENTIONS:
        if needed <= {*plain} and not absent & {*plain}:
            plain = tuple(translated.get(word, word) for word in plain)
    return plain


@cache
def joint_keys(names: Names) -> Names:
    """Give a word for each joint of a list that is equal for equal joints: Human3.6M's name where it has one.

    Parameters
    ----------
    names : tuple of str
        All names of one list of joints, in any spelling.

    Returns
    -------
    tuple of str
        One word each. Where a list has several spellings of one name, the most specific one takes the name, and the
        others stay joints of their own.

    Examples
    --------
    >>> joint_keys(("left_ankle", "head"))
    ('LFoot', 'Head')
    >>> joint_keys(("left_ankle", "left_foot", "head", "head_top"))
    ('LFoot', 'lfoot', 'head', 'Head')
    >>> joint_keys(("Spine1", "Neck", "Head", "Site"))  # as Human3.6M calls them
    ('Spine', 'Thorax', 'Neck/Nose', 'Head')
    """
    plain = _meanings(names)
    there = {*plain}
    first = {name: next((word for word in spelt if word in there), None) for name, spelt in _SPELLINGS.items()}
    keys = [name if (name := _MEANINGS.get(word)) and first[name] == word else word for word in plain]
    count = Counter(keys)
    return tuple(key if count[key] == 1 or key in _SPELLINGS else name for key, name in zip(keys, names, strict=True))


def canonical_names(names: Names) -> Names:
    """Give Human3.6M's names of the joints of a list, and those that it lacks as they are spelt."""
    return tuple(key if key in _SPELLINGS else name for key, name in zip(joint_keys(names), names, strict=True))


def distinguished(names: Names) -> Names:
    """Tell repeated ends of bones (``Site``) apart by the joint before them; other names stay as they are."""
    sites = [letters(name) == "site" for name in names]
    if sum(sites) < 2:
        return names
    return tuple(
        f"{name} of {names[k - 1]}" if is_site and k else name
        for k, (name, is_site) in enumerate(zip(names, sites, strict=True))
    )


def repeated_names(names: Names) -> list[str]:
    """Give the names of joints that a list has more than once, as they are spelt."""
    count = Counter(joint_keys(names))
    spelt: dict[str, list[str]] = {}
    for key, name in zip(joint_keys(names), names, strict=True):
        if count[key] > 1:
            spelt.setdefault(key, []).append(name)
    return [" = ".join(dict.fromkeys(some)) for some in spelt.values()]


def find_joint(name: str, names: Names) -> int | None:
    """Find a joint by name, as the list spells it or else by what the name means, or by number."""
    if name in names:
        return names.index(name)
    if name.isdecimal():
        return int(name) if int(name) < len(names) else None
    for word, words in (
        (letters(name), [letters(other) for other in names]),
        (joint_keys((name,))[0], joint_keys(names)),
    ):
        if word and list(words).count(word) == 1:
            return list(words).index(word)
    return None


def match_joints(names: Names, others: Names) -> tuple[dict[int, int], list[str]]:
    """Match two lists of joints by what their names mean.

    Parameters
    ----------
    names, others : tuple of str
        Two lists, each without repeated joints.

    Returns
    -------
    matched : dict
        The number of the same joint in ``others``, by that in ``names``.
    ambiguous : list of str
        In words, the names that may mean one of two joints of the other list, with all spellings.

    Examples
    --------
    >>> match_joints(("RAnkle", "Nose"), ("right_foot", "left_foot"))
    ({0: 0}, [])
    >>> match_joints(("RFoot",), ("right_ankle", "right_foot"))
    ({}, ['RFoot may be right_ankle or right_foot'])
    """
    own, their = _by_word(names), _by_word(others)
    ambiguous, unclear = [], set()
    for (some, few), (many, more) in permutations(((own, names), (their, others))):
        for word, beside in _UNCLEAR.items():
            if word in some and word not in many and any(other in many for other in beside):
                meant = [more[k] for other, k in many.items() if other in beside or _MEANINGS[other] == _MEANINGS[word]]
                choice = " or ".join(meant if len(meant) > 1 else [*meant, "another point"])
                ambiguous.append(f"{few[some[word]]} may be {choice}")
                unclear.add(_MEANINGS[word])
    keys = {key: k for k, key in enumerate(joint_keys(others)) if key not in _SPELLINGS}
    matched = {k: keys[key] for k, key in enumerate(joint_keys(names)) if key in keys}
    for name in _SPELLINGS.keys() - unclear:
        mine, theirs = ({w: k for w, k in words.items() if _MEANINGS[w] == name} for words in (own, their))
        (some, few), (many, more) = sorted([(mine, names), (theirs, others)], key=lambda side: len(side[0]))
        if len(some) == 1 < len(many) and not _CLEAR & some.keys():
            choice = " or ".join(more[k] for k in many.values())
            ambiguous.append(f"{few[next(iter(some.values()))]} may be {choice}")
        elif len(some) == len(many) == 1:
            matched |= zip(mine.values(), theirs.values(), strict=True)
        else:
            matched |= {mine[word]: theirs[word] for word in mine.keys() & theirs.keys()}
    return matched, sorted(ambiguous)


def _by_word(names: Names) -> dict[str, int]:
    """Give the numbers of the joints that may have one of Human3.6M's names, by their letters."""
    return {word: k for k, word in enumerate(_meanings(names)) if word in _MEANINGS}


def remarks_on_matched(names: Names, others: Names, matched: Mapping[int, int]) -> Iterator[str]:
    """Say which joints of two lists are taken as one though data sets place them differently under these names."""
    words, other_words = _meanings(names), _meanings(others)
    pairs = [(k, j) for k, j in sorted(matched.items()) if letters(names[k]) != letters(others[j])]
    loose = [(k, j) for k, j in pairs if words[k] != other_words[j] and _MEANINGS.get(words[k]) in _LOOSE]
    if loose:
        shown = first_few([f"{names[k]} and {others[j]}" for k, j in loose])
        yield f"joints: {shown} are taken as one; rename them where they are different points."


def remarks_on_names(names: Names, known: Iterable[str]) -> Iterator[str]:
    """Say which names mean otherwise than they would alone, and which lie near known ones and stay unknown.

    Parameters
    ----------
    names : tuple of str
        A list of joints.
    known : iterable of str
        All names that joint sets have.

    Yields
    ------
    str
        Remarks.
    """
    alone, together = [joint_keys((name,))[0] for name in names], joint_keys(names)
    read = [
        f"{name} is {key}"
        for name, one, key in zip(names, alone, together, strict=True)
        if key in _SPELLINGS and one != key
    ]
    if read:
        yield f"joints: named as in Human3.6M's own lists, so {first_few(read, 5)}."
    if len(names) > MOST_NAMED:
        return
    words = {letters(name): name for name in (*known, *_MEANINGS.values())}
    words |= {spelt: spelt[0].upper() + spelt[1:].title() for spelt in _MEANINGS if spelt not in words}
    near = []
    for name, key in zip(names, together, strict=True):
        word = letters(name)
        if key not in _SPELLINGS and word not in words:
            inside = sorted((spelt for spelt in words if len(spelt) > 3 and spelt in word), key=len)
            nearest = inside[-1:] or get_close_matches(word, words, n=1, cutoff=0.8)
            near += [f"{name} (like {words[nearest[0]]})"] if nearest else []
    if near:
        yield (
            f"joints: {first_few(near, 5)} not known by name, so outside joint sets and without bones of a person; "
            "rename them if they are meant."
        )


def side_of(name: str) -> str:
    """Give ``left``, ``right`` or ``middle``, as a joint's name says: a side written out, or as one letter.

    Examples
    --------
    >>> side_of("left_index1"), side_of("R_Eye"), side_of("rThumb"), side_of("root"), side_of("Lantern")
    ('left', 'right', 'right', 'middle', 'middle')
    """
    word = re.sub(r"[\W_]", "", name.lower())
    if side := re.search(r"^(left|right)|(left|right)$", word):
        return side[0]
    known = _MEANINGS.get(letters(name), "")
    letter = re.match(r"[LRlr](?=[A-Z][a-z]|[\W_])", name) or re.match(r"[LR](?=[A-Z])", known)
    return "middle" if letter is None else {"l": "left", "r": "right"}[letter[0].lower()]

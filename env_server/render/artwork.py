"""The sprites and tiles with which Infinite Mario is drawn: our own, one letter per pixel.

`PALETTE` gives each letter its color; a dot is transparent. Sprites face right and stand on their
last line; a tile is 16 by 16 pixels. Pictures listed as halves are mirrored.
"""

from __future__ import annotations

from typing import Final

PALETTE: Final = {
    "k": (0x2A, 0x1B, 0x2E),  # outline
    "w": (0xFF, 0xFF, 0xFF),
    "r": (0xE3, 0x3B, 0x3B),
    "R": (0xA8, 0x1F, 0x33),
    "b": (0x3B, 0x6F, 0xD9),
    "B": (0x24, 0x46, 0x9C),
    "t": (0xFF, 0xD0, 0xA3),  # skin
    "T": (0xE3, 0x9E, 0x72),
    "n": (0x8C, 0x54, 0x2F),  # earth
    "N": (0x64, 0x38, 0x24),
    "m": (0xA8, 0x6B, 0x3C),
    "y": (0xFF, 0xD8, 0x4A),
    "Y": (0xE0, 0x9A, 0x1F),
    "o": (0xF4, 0x7F, 0x2B),
    "g": (0x4F, 0xB8, 0x3F),  # grass
    "G": (0x2C, 0x82, 0x34),
    "l": (0x9A, 0xDE, 0x5B),
    "p": (0xB0, 0x57, 0xC9),  # spikes
    "P": (0x6F, 0x2F, 0x8A),
    "s": (0xC2, 0xC8, 0xD6),  # stone
    "S": (0x87, 0x8F, 0xA8),
    "d": (0x5C, 0x63, 0x7F),
    "h": (0x7C, 0xCB, 0x6E),  # hill, behind
    "H": (0x69, 0xB8, 0x60),
    "1": (0x5F, 0xA8, 0xF0),  # sky, from the top
    "2": (0x74, 0xB7, 0xF4),
    "3": (0x8B, 0xC6, 0xF7),
    "4": (0xA4, 0xD5, 0xF9),
    "5": (0xBE, 0xE3, 0xFB),
    "6": (0xD8, 0xF0, 0xFD),
    "7": (0x9C, 0xCF, 0xD8),  # mountains far away
    "8": (0x86, 0xC2, 0xB4),
}

_GRASS = """
llllllllllllllll
gglgggglggggglgg
gggggggggggggggg
gGggggGggggGgggg
GnGGgGnGggGnGgGG
nnnGGnnnGGnnnGnn
nnnnnnnnnnnnnnnn
nmnnnnnnnnmnnnnn
nnnnnNnnnnnnnnnn
nnnnnnnnnnnnNnnn
nnmnnnnnnnnnnnnn
nnnnnnnnmnnnnnnn
nnnNnnnnnnnnnnmn
nnnnnnnnnnNnnnnn
nnnnnnmnnnnnnnnn
nnnnnnnnnnnnnnnn
"""
_EARTH = """
nnnnnnnnnnnnnnnn
nnnnmnnnnnnnnnnn
nnnnnnnnnnNnnnnn
nNnnnnnnnnnnnnnn
nnnnnnnmnnnnnnmn
nnnnnnnnnnnnnnnn
nnmnnnnnnnnmnnnn
nnnnnNnnnnnnnnnn
nnnnnnnnnnnnnnnn
nnnnnnnnmnnnnNnn
nmnnnnnnnnnnnnnn
nnnnnnnnnnnnnnnn
nnnnnnNnnnnnnnmn
nnnnnnnnnnmnnnnn
nnNnnnnnnnnnnnnn
nnnnnnnnnnnnnnnn
"""
_LEDGE = """
llllllllllllllll
ggllggggggllgggg
gggggggggggggggg
GgggGggggGggggGg
GGgGGGgGGGGggGGG
hGGGhGGGhhGGGGhh
hhHhhhGhhhhHGhhh
hhhhhhhhhhhhhhhh
hhhhHhhhhhhhhhHh
hhhhhhhhhhhhhhhh
hHhhhhhhHhhhhhhh
hhhhhhhhhhhhhhhh
hhhhhHhhhhhhHhhh
hhhhhhhhhhhhhhhh
hhHhhhhhhHhhhhhh
hhhhhhhhhhhhhhhh
"""
_HILL = """
hhhhhhhhhhhhhhhh
hhhhhHhhhhhhhhhh
hhhhhhhhhhhhHhhh
hhHhhhhhhhhhhhhh
hhhhhhhhHhhhhhhh
hhhhhhhhhhhhhhHh
hhhhHhhhhhhhhhhh
hhhhhhhhhhHhhhhh
hHhhhhhhhhhhhhhh
hhhhhhHhhhhhhhhh
hhhhhhhhhhhhHhhh
hhhHhhhhhhhhhhhh
hhhhhhhhhHhhhhhh
hhhhhhhhhhhhhhHh
hHhhhhHhhhhhhhhh
hhhhhhhhhhhhhhhh
"""
_STONE = """
kkkkkkkkkkkkkkkk
kwsssssssssssssk
kssssssssssssSdk
ksskssssssskSSdk
ksskksssssskSSdk
kssssssssssssSdk
kssssssssssssSdk
kssssssssssssSdk
kssssssssssssSdk
kssssssssssssSdk
kssssssssssssSdk
ksskssssssskSSdk
ksskksssssskSSdk
ksSSSSSSSSSSSSdk
kddddddddddddddk
kkkkkkkkkkkkkkkk
"""
_BRICK = """
oooooookoooooook
oYYYYYokoYYYYYok
oYooooRkoYooooRk
oooooRRkoooooRRk
kkkkkkkkkkkkkkkk
oookoooooookoooo
YYokoYYYYYokoYYY
ooRkoYooooRkoYoo
oRRkoooooRRkoooo
kkkkkkkkkkkkkkkk
oooooookoooooook
oYYYYYokoYYYYYok
oYooooRkoYooooRk
oooooRRkoooooRRk
kkkkkkkkkkkkkkkk
kRRRRRRkkRRRRRRk
"""
_QUESTION = """
.kkkkkkkkkkkkkk.
kyyyyyyyyyyyyyyk
kywyyyyyyyyyywYk
kyyyyykkkkyyyyYk
kyyyykwwwwkyyyYk
kyyykwwkkwwkyyYk
kyyyykkyykwwkyYk
kyyyyyyykwwkyyYk
kyyyyyykwwkyyyYk
kyyyyyykwwkyyyYk
kyyyyyyykkyyyyYk
kyyyyyykwwkyyyYk
kyyyyyykwwkyyyYk
kywyyyyykkyyywYk
kYYYYYYYYYYYYYYk
.kkkkkkkkkkkkkk.
"""
_COIN = """
................
.....kkkkkk.....
...kkyyyyyYkk...
...kyywwyyyYk...
..kyywyyyyyyYk..
..kyywyYYyyyYk..
..kyywyYYyyyYk..
..kyywyYYyyyYk..
..kyywyYYyyyYk..
..kyywyYYyyyYk..
..kyyyyYYyyyYk..
...kyyyyyyyYk...
...kkyyyyyYkk...
.....kkkkkk.....
................
................
"""
_PIPE_MOUTH = (
    ("kkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkk",)
    + ("kGlllwlllggggggggggggggGGGgGGGGk",) * 10
    + ("kGGGGGGGGGGGGGGGGGGGGGGGGGGGGGGk",)
    + ("kkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkk",)
    + ("..kGGGGGGGGGGGGGGGGGGGGGGGGGGk..",)
    + ("..kGllwllgggggggggggggGGgGGGGk..",) * 2
)
_PIPE_SHAFT = ("..kGllwllgggggggggggggGGgGGGGk..",) * 16
_POLE = """
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
"""
_POLE_TOP = """
................
................
................
................
................
................
................
......kkkk......
.....kyyyyk.....
....kyywyyyk....
....kyyyyyYk....
....kyyyyYYk....
.....kYYYYk.....
......kkkk......
......kSswk.....
......kSswk.....
"""
_FLAG = """
......kSswkkkkk.
......kSswkrrrrk
......kSswkrrrrk
......kSswkrwrwk
......kSswkrrwrk
......kSswkrwrwk
......kSswkrrrrk
......kSswkrrrk.
......kSswkrrk..
......kSswkrk...
......kSswkk....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
......kSswk.....
"""


def _lines(text: str) -> tuple[str, ...]:
    return tuple(text.split())


TILES: Final = {
    "grass": _lines(_GRASS),
    "earth": _lines(_EARTH),
    "ledge": _lines(_LEDGE),
    "hill": _lines(_HILL),
    "stone": _lines(_STONE),
    "brick": _lines(_BRICK),
    "question": _lines(_QUESTION),
    "coin": _lines(_COIN),
    "pole": _lines(_POLE),
    "pole top": _lines(_POLE_TOP),
    "flag": _lines(_FLAG),
    "mouth left": tuple(line[:16] for line in _PIPE_MOUTH),
    "mouth right": tuple(line[16:] for line in _PIPE_MOUTH),
    "shaft left": tuple(line[:16] for line in _PIPE_SHAFT),
    "shaft right": tuple(line[16:] for line in _PIPE_SHAFT),
}

_MARIO_SMALL = """
.....kkkkkk.....
....krrrrrrk....
...krrwrrrrrk...
...krrrrrrrrrkk.
...kRRRRRRRRRRRk
...kNttttkttkkk.
..kNNtTttwktwk..
..kNttTttwktwk..
..kkttttttttttk.
...kttNNNNNNNtk.
....kttttttttk..
...krrbrrrbrk...
..kttbbyyybbtk..
..kttbbbbbbbtk..
...kbbbkkbbbk...
...kNNNk.kNNNk..
"""
_MARIO_LARGE = """
.....kkkkkkk....
....krrrrrrrk...
...krrwwrrrrrk..
...krwwrrrrrrkk.
...krrrrrrrrrrrk
...kRRRRRRRRRRRk
...kNNttttkttkk.
..kNNNtTttwktwk.
..kNNttTttwktwk.
..kkNttTtttkttk.
...ktttttttttttk
...kttNNNNNNNNtk
....ktttNNNNttk.
.....kttttttkk..
....krrbrrrrbk..
...krrrbrrrrbrk.
..krrrrbbrrbbrrk
..krrrrbyybyybrk
..kttkbbbbbbbktk
..kttkbbbbbbbktk
...kkbbbbbbbbbkk
....kbbbbbbbbbk.
....kbbbkkkbbbk.
....kBBBk.kBBBk.
...kNNNNk.kNNNNk
...kNNNNNkNNNNNk
"""
_GOOMBA_HALF = """
......kk
....kknn
...knnmm
..knnmmn
.knkknnn
.knwwknn
knnwkkkn
knnwkkkn
knnnwwnn
knnnnnnn
.knNkwNN
..kkkkkk
...ktttt
..kNkttt
.kNNNkkk
.kkkkk..
"""
_KOOPA = """
........kkkk....
.......klllgkk..
.......klgwkwkk.
.......kggwkwkgk
.......kgggggggk
.......kgggggkkk
........kggkkk..
...kkkkkkgggk...
..kCCCCCkkggk...
.kCccCccCkggk...
.kcCCccCCckgk...
kcCccCCccCkgk...
kcccCccCcckggk..
kCcccCcccckgk...
kwCcccccCwkgk...
.kwwwwwwwwkkk...
..kkkkkkkkYk....
...kYYkkYYk.....
..kYYYkkYYYk....
..kkkk..kkkk....
"""
_SPIKY = """
.......k........
...k..kwk..k....
..kwk.kwk.kwk...
..kpwkppkkwpk.k.
.kppppppppppkkwk
kwkpPppPppPppwk.
.kkppPppPppPpkk.
.kpPppPppPppppkk
kpppPppPpppPpppk
kPPPPPPPPPPPPPPk
kkYYYYYYYYkwkYk.
.kYYYYYYYYkwkYYk
..kkYYkkkYYkkkk.
....kkk..kkk....
"""
_PLANT_HALF = """
..kkk...
.krrrk..
krwrrrk.
krrrwrwk
krrrrrwk
krwrrrrw
krrrrrrk
krrwrrrw
.krrrrrr
.kkrrwrr
...kkrrr
.....kkk
......kg
.kkk..kg
kgllk.kg
kgggGkkg
.kggGGkg
..kkGGgg
....kkgg
......kg
......kg
......kg
......kg
......kg
"""
_SHELL = """
.....kkkkkk.....
...kkgGgggGkk...
..kgGggGGgggGk..
.kgGggGggGgggGk.
.kGggGggggGggGk.
kggGGgggggGGgggk
kgggGggggggGgggk
kGgggGGggGGgggGk
kkGGGGGGGGGGGGkk
kwwkkwwwwwwkkwwk
.kwwwwwwwwwwwwk.
..kkkkkkkkkkkk..
"""
_MUSHROOM_HALF = """
.....kkk
...kkrrr
..krrrrw
.krwwrww
.kwwwwrw
krwwwwrr
krrwwrrr
krrrrrrr
kRRkkkkk
.kktttkt
..kttktt
..kttktt
..kttttt
..kTtttt
...kTTtt
....kkkk
"""
_FLOWER_HALF = """
....kkkk
..kkoooo
.kooyyyy
kooyywww
kooywkww
koyywkww
kooyywww
.kooyyyy
..kkoooo
....kkkk
......kg
.kkk..kg
klggk.kg
.kgggkkg
..kkGGgg
....kkkk
"""
_FIREBALL = """
..koook.
.koyyook
koyywyok
koywwyok
koyyyyok
kooyyook
.kooook.
..kkkk..
"""


def _whole(half: str) -> tuple[str, ...]:
    return tuple(line + line[::-1] for line in _lines(half))


def _shelled(letters: str) -> tuple[str, ...]:
    return _lines(_KOOPA.translate(str.maketrans("cC", letters)))


def _in_white(picture: str) -> tuple[str, ...]:
    return _lines(picture.translate(str.maketrans("rRbB", "wsrR")))


SPRITES: Final = {
    0: _lines(_MARIO_SMALL),
    10: _lines(_MARIO_LARGE),
    11: _in_white(_MARIO_LARGE),
    1: _shelled("rR"),
    2: _shelled("gG"),
    3: _whole(_GOOMBA_HALF),
    4: _lines(_SPIKY),
    5: _whole(_PLANT_HALF),
    6: _whole(_MUSHROOM_HALF),
    7: _whole(_FLOWER_HALF),
    8: _lines(_FIREBALL),
    9: _lines(_SHELL),
}
"""Sprites by their kind in observations."""

WING: Final = _lines("""
....kkk.
..kkwwwk
.kwwwwwk
kwwwwwk.
kwwwwkk.
kwsskwk.
.kwwwk..
..kkk...
""")

CLOUD: Final = _lines("""
..........wwwwww................
........wwwwwwwwww..............
.......wwwwwwwwwwwww............
...wwwwwwwwwwwwwwwwwwwwww.......
..wwwwwwwwwwwwwwwwwwwwwwwww.....
.wwwwwwwwwwwwwwwwwwwwwwwwwwwww..
wwwwwwwwwwwwwwwwwwwwwwwwwwwwwwww
.6666wwwwwww666666wwwwwww666666.
...66666666....666666666........
""")
MARK: Final = ("..k..", ".kwk.", "kwwwk", ".kwk.", "..k..")

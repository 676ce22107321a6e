"""Translation of German words in column names to the English words that `names` knows."""

_WORDS = {
    german: english
    for english, words in {
        "time": "zeit zeitpunkt zeitstempel uhrzeit sekunden",
        "angular velocity": "drehrate drehraten winkelgeschwindigkeit drehgeschwindigkeit kreisel",
        "acceleration": "beschleunigung beschleunigungen linearbeschleunigung",
        "angle": "winkel gelenkwinkel gelenkstellung stellung",
        "velocity": "geschwindigkeit gelenkgeschwindigkeit drehzahl",
        "torque": "moment momente drehmoment gelenkmoment motormoment",
        "force": "kraft",
        "foot force": "fusskraft bodenkraft aufstandskraft",
        "contact": "kontakt bodenkontakt",
        "foot contact": "fusskontakt",
        "foot": "fuss fuesse",
        "joint": "gelenk gelenke",
        "hip": "huefte hueftgelenk",
        "thigh": "oberschenkel",
        "knee": "knie kniegelenk",
        "calf": "unterschenkel",
        "leg": "bein",
        "front": "vorn vorne vorder vorderes",
        "rear": "hinten hinter hinteres",
        "left": "links linker linkes linke",
        "right": "rechts rechter rechtes rechte",
        "attitude": "lage orientierung ausrichtung",
        "reference": "referenz",
        "desired": "soll sollwert",
        "measured": "ist istwert gemessen",
        "body": "rumpf koerper",
        "roll": "rollen rollwinkel wankwinkel",
        "pitch": "nicken nickwinkel",
        "yaw": "gieren gierwinkel",
        "fl": "vl",  # of "vorne links"; "hinten" begins as "hind" does
        "fr": "vr",
        "deg": "grad",
    }.items()
    for german in words.split()
}
_LETTERS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"} | {"Ä": "Ae", "Ü": "Ue"})


def in_plain_letters(name: str) -> str:
    """Replace umlauts in a name: "Hüfte" becomes "Huefte"."""
    return name.translate(_LETTERS)


def in_english(words: list[str]) -> list[str]:
    """Translate German words, in lower case and plain letters, keeping their numbers."""
    english: list[str] = []
    for word in words:
        letters = word.rstrip("0123456789")
        english += (_WORDS.get(letters, letters) + word[len(letters) :]).split()
    return english

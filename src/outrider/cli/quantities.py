"""Numbers as people type them: 20deg, 2:20, 67.2,823.1,2818.5; angles in rad without a unit."""

from math import isfinite, pi

from outrider.errors import InputError

Span = tuple[float, float]


def number(text: str, what: str) -> float:
    """A number, or an angle such as 20deg in rad."""
    word = text.strip().lower()
    try:
        value = float(word.removesuffix("deg")) * (pi / 180.0 if word.endswith("deg") else 1.0)
    except ValueError as error:
        raise InputError(f"{what} {text!r}; want a number, angles in rad or such as 20deg") from error
    if not isfinite(value):
        raise InputError(f"{what} {text!r}; want a finite number")
    return value


def span(text: str, what: str) -> Span:
    """Two numbers with a colon, the smaller first; one number: from itself to itself."""
    parts = [number(part, what) for part in text.split(":")]
    if not (len(parts) in (1, 2) and parts[0] <= parts[-1]):
        raise InputError(f"{what} {text!r}; want LOW:HIGH")
    return parts[0], parts[-1]


def listed(text: str, what: str) -> list[float]:
    """Numbers with commas between them."""
    return [number(part, what) for part in text.split(",")]


def pair(text: str, what: str) -> Span:
    """Two numbers with a comma."""
    parts = listed(text, what)
    if len(parts) != 2:
        raise InputError(f"{what} {text!r}; want two numbers, A,B")
    return parts[0], parts[1]


def pairs(given: list[str] | None, option: str) -> dict[str, str]:
    """Name and value of each NAME=VALUE."""
    parts = [text.partition("=") for text in given or []]
    for (name, sep, value), text in zip(parts, given or [], strict=True):
        if not (name.strip() and sep and value.strip()):
            raise InputError(f"{option} {text!r}; want name=value")
    return {name.strip(): value.strip() for name, _, value in parts}


def values(given: list[str] | None, option: str) -> dict[str, float]:
    """Name and number of each NAME=NUMBER."""
    return {key: number(text, f"{option} {key}") for key, text in pairs(given, option).items()}

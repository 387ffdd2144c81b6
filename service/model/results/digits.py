"""The one rule for the digits of a measured value: as many as its standard deviation leaves, which has two."""

import math


def with_std(value: float, std: float | None, sign: str = "") -> tuple[str, str]:
    """Value and standard deviation as a person reads them: ``("253.2", "9.5")``, ``("12350", "120")``.

    The value is rounded to the digit of the standard deviation's second significant digit (JCGM 100:2008, 7.2.6), so a
    value far below it is 0. Without a standard deviation it has five digits, and the second text is a dash. `sign`: "+"
    for a difference.
    """
    if std is None or not (0 < std < math.inf and math.isfinite(value)):
        return f"{value:{sign}.5g}", "–"
    decimals = 1 - int(f"{std:.1e}".partition("e")[2])
    if decimals > 7 or abs(value) >= 1e7:
        digits = max(0, decimals + int(f"{value:e}".partition("e")[2]))
        return f"{value:{sign}.{digits}e}", f"{std:.1e}"
    shown = max(decimals, 0)
    return f"{round(value, decimals) + 0.0:{sign}.{shown}f}", f"{round(std, decimals):.{shown}f}"


def two_digits(value: float) -> str:
    """A confidence, or another standard deviation in percent: ``"0.42"``, ``"12"``, ``"130"``."""
    return f"{float(f'{value:.2g}'):.7g}"

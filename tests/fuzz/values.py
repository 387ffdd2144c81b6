"""What is put where something else is expected."""

from random import Random

LONG = "n" * 5000
DEEP = 3000

PLAIN: tuple[object, ...] = (
    None, True, False, "", "x", 0, -1, 1, 3, 0.5, -0.0, float("nan"), float("inf"), float("-inf"), 1e308, -1e308,
    5e-324, 1e-300, 1e16, 2**31, 2**53 + 1, 2**63, 2**64, -(2**63) - 1, 10**400, [], {}, [[]], [1, 2], [None],
    {"a": 1}, [0.0] * 7, LONG, "a\x07b", "\x1b[31mred", "..", "../../../../dev/zero", "/dev/null", "%s{0}", "nan",
    "1e999", "0x10", "true", "ä\u202eb", "joint_1", "\n",
)  # fmt: skip

YAML = (
    ".nan", "-.inf", "1e308", "5e-324", "-0", "2001-13-45", "2001-01-01T25:61:61", "0b", "0x", "0b_", "_",
    "1:99:99.9", "9" * 5000, "=", "<<: 1", "<<: [1]", "!!binary x", "!!int abc", "!!float x", "!!bool x",
    "!!timestamp x", "!!int ''", "!!python/object:os.system x", "!!set {a}", "!!omap [a: 1]", "!!pairs [a]",
    "!!null x", "*none", "&a [*a]", "&a {b: *a}", "[" * DEEP, "[" * DEEP + "]" * DEEP, "{a: " * 400 + "1" + "}" * 400,
    "{a: 1, a: 2}", "{? [1] : 2}", "{? {} : 2}", "|", ">", "\t", "'", "%", "@", "`", "- - - x", "{1: 2}", "{null: 2}",
    "{.nan: 2}", "!x y", "---\n--- x", "!!str 5", "!!seq [1]", "!!map {a: 1}", "\x00", "\x85", "1e400", "0o8",
    "190:20:30", "+", "-", "~",
    "[&b [x, x, x], &c [*b, *b, *b], &d [*c, *c, *c], &e [*d, *d, *d], &f [*e, *e, *e], &g [*f, *f, *f], *g]",
)  # fmt: skip

JSON = (
    "NaN", "Infinity", "-Infinity", "1e999", "-1e999", "-0", "1e-400", "9" * 5000, '"\\ud800"', '"\\u0000"',
    "[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, '{"a": 1, "a": 2}', "tru", "'x'", "[1,]",
    '"', "1.", ".5", "0x10", "+1", "\ufeff1", '"\t"', '{"__proto__": 1}', "[" * 190 + "]" * 190,
)  # fmt: skip

TEXT = (
    "", " ", "0", "-0", "1", "-1", "nan", "inf", "-inf", "1e308", "1e16", "1e-300", "5e-324", "1e999", "9" * 5000,
    str(2**31), str(2**64), "0x", "0xFFFFFFFFFFFFFFFFFF", "0x80000000", "abc", "1,5", "1_0", "٣", "$NODEID+0x80",
    "$NODEID", "%(x)s", "a" * 5000, "..", "/dev/null", "../../../dev/zero", "\x00", "\x07", "1 2 3",
    "1e308 1e308 1e308", "0 0 0", "1e-300 0 0", "nan 0 0", "true", "fixed", "mesh", "package://a/../b",
    "package://p/m.stl", "file:///etc", "é", "\u2028", "65536", "255", "-32768", "3.5", "[x]", "=", ";", '"',
)  # fmt: skip


def text(rng: Random) -> str:
    return rng.choice(TEXT)

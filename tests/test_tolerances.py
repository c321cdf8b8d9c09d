"""Every tolerance in a test is a class of `tests/tolerances.py` or a name with its reason, as CONTRIBUTING.md asks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted([*ROOT.glob("tests/**/*.py"), *ROOT.glob("examples/*/test_*.py")])
CLASSES = "tests.tolerances"
MODULES = {"math", "np"}
"""Their functions and constants are numbers, too: math.sqrt(1e-12) is as loose as 1e-6."""
TAKES = {
    "pytest.approx": ("rel", "abs"),
    "math.isclose": ("rel_tol", "abs_tol"),
    "np.allclose": ("rtol", "atol"),
    "np.isclose": ("rtol", "atol"),
    "np.testing.assert_allclose": ("rtol", "atol"),
}
"""function -> its tolerances, in the order in which they follow what is compared."""
NEEDS = {
    "pytest.approx": [{"rel", "abs"}],  # without any 1e-6, relative
    "math.isclose": [{"rel_tol", "abs_tol"}],  # 1e-9, relative
    "np.allclose": [{"rtol"}, {"atol"}],  # 1e-5 and 1e-8
    "np.isclose": [{"rtol"}, {"atol"}],
    "np.testing.assert_allclose": [{"rtol"}],  # 1e-7
}
"""function -> one of each of these is given, or a default that nobody chose counts."""
DIGITS = {"assert_almost_equal", "assert_array_almost_equal", "assert_approx_equal"}
"""They count decimals."""
ADVICE = (
    "take EXACT, ROUNDOFF, discretisation(), physics() or chance() of tests/tolerances.py, or a constant of the module whose reason "
    "stands below it as a docstring or beside it as a comment (CONTRIBUTING.md)"
)


class Source:
    """A file of tests."""

    def __init__(self, text: str) -> None:
        self.lines, self.tree = text.splitlines(), ast.parse(text)
        self.classes = {
            a.asname or a.name
            for n in self.tree.body
            if isinstance(n, ast.ImportFrom) and (n.module == CLASSES or (n.module == "tests" and n.names[0].name == "tolerances"))
            for a in n.names
        }
        self.constants = dict(assigned(self.tree.body))
        self.reasons = {
            name
            for statement, after in zip(self.tree.body, [*self.tree.body[1:], None], strict=True)
            for name, _ in assigned([statement])
            if self.explained(statement, after)
        }

    def explained(self, statement: ast.stmt, after: ast.stmt | None) -> bool:
        """Whether a docstring follows a statement, or it has a comment beside or above it."""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            return True
        beside = "".join(self.lines[statement.lineno - 1 : statement.end_lineno])
        above = self.lines[statement.lineno - 2].strip() if statement.lineno > 1 else ""
        return "#" in beside or above.startswith("#")

    def faults(self) -> Iterator[tuple[int, str]]:
        """Line, and what is wrong there."""
        functions = [n for n in ast.walk(self.tree) if isinstance(n, ast.FunctionDef)]
        for call in (n for n in ast.walk(self.tree) if isinstance(n, ast.Call)):
            name = ast.unparse(call.func)
            short = name.rpartition(".")[2]
            if short in DIGITS:
                yield call.lineno, f"{short} counts decimals: compare with pytest.approx"
            known = next((k for k in TAKES if name in (k, k.rpartition(".")[2])), None)
            if known is None:
                continue
            given = dict(zip(TAKES[known], call.args[1 if known == "pytest.approx" else 2 :], strict=False))
            given |= {k.arg: k.value for k in call.keywords if k.arg in TAKES[known]}
            for some in NEEDS[known]:
                if not some & given.keys():
                    yield call.lineno, f"{short} without {' or '.join(sorted(some))} has a default that nobody chose: {ADVICE}"
            around = [statement for f in functions if f.lineno <= call.lineno <= (f.end_lineno or 0) for statement in ast.walk(f)]
            local = dict(assigned(around))
            for keyword, value in given.items():
                if fault := self.fault(value, local):
                    yield call.lineno, f"{keyword} = {ast.unparse(value)} {fault}"

    def fault(self, value: ast.expr, local: dict[str, ast.expr]) -> str:
        """What is wrong with a tolerance; 0 switches one off."""
        if isinstance(value, ast.Constant) and value.value == 0:
            return ""
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add):
            return self.fault(value.left, local) or self.fault(value.right, local)
        names = named(value)
        if not names:
            return f"is a loose number: {ADVICE}"
        if not any(self.reasoned(name, local) for name in names):
            return f"has no reason beside {', '.join(sorted(names))}: {ADVICE}"
        return ""

    def reasoned(self, name: str, local: dict[str, ast.expr]) -> bool:
        """Whether a name is more than another word for a number; what is calculated, or comes from elsewhere, is."""
        if name in local:
            return bool(named(local[name]))
        return name in self.classes or name not in self.constants or name in self.reasons


def assigned(statements: list[ast.stmt] | list[ast.AST]) -> Iterator[tuple[str, ast.expr]]:
    """Names and what they are, of plain assignments."""
    for statement in statements:
        if isinstance(statement, ast.Assign):
            for target in statement.targets:
                for name in ast.walk(target):
                    if isinstance(name, ast.Name):
                        yield name.id, statement.value
        elif isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value is not None:
            yield statement.target.id, statement.value


def named(value: ast.expr) -> set[str]:
    """Names in an expression, but for those of modules."""
    return {n.id for n in ast.walk(value) if isinstance(n, ast.Name)} - MODULES


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_tolerance_has_a_reason(path: Path) -> None:
    where = path.relative_to(ROOT).as_posix()
    faults = [f"{where}:{line}: {what}" for line, what in Source(path.read_text(encoding="utf-8")).faults()]
    assert not faults, "\n" + "\n".join(faults)


@pytest.mark.parametrize(
    "line",
    [
        "x == pytest.approx(1.0)",
        "x == approx(1.0)",
        "x == pytest.approx(1.0, rel=1e-6)",
        "x == pytest.approx(1.0, 1e-6)",
        "x == pytest.approx(1.0, rel=ROUNDOFF, abs=1e-6)",
        "x == pytest.approx(1.0, abs=4 * math.sqrt(1 / 2000))",
        "x == pytest.approx(1.0, abs=PLAIN)",
        "x == pytest.approx(1.0, abs=2.0 * wide)",
        "x == pytest.approx(1.0, abs=ROUNDOFF + 1e-3)",
        "np.testing.assert_allclose(x, y, atol=ROUNDOFF)",
        "np.testing.assert_allclose(x, y, 1e-7)",
        "np.testing.assert_almost_equal(x, y)",
        "np.allclose(x, y, rtol=ROUNDOFF)",
        "np.allclose(x, y)",
        "math.isclose(x, y, rel_tol=0.02)",
        "math.isclose(x, y)",
    ],
)
def test_a_loose_number_is_found(line: str) -> None:
    assert {n for n, _ in Source(written(line)).faults()} == {12}


@pytest.mark.parametrize(
    "line",
    [
        "x == pytest.approx(1.0, rel=1e3 * ROUNDOFF)",
        "x == pytest.approx(1.0, abs=REASON)",
        "x == pytest.approx(1.0, abs=BESIDE)",
        "x == pytest.approx(1.0, abs=narrow)",
        "x == pytest.approx(1.0, abs=REASON / PLAIN)",
        "np.testing.assert_allclose(x, y, rtol=0.0, atol=10 * ROUNDOFF)",
        "np.allclose(x, y, rtol=ROUNDOFF, atol=0)",
        "math.isclose(x, y, rel_tol=REASON)",
        "other.approx_time(1e-6)",
    ],
)
def test_a_class_or_a_name_with_a_reason_is_none(line: str) -> None:
    assert not list(Source(written(line)).faults())


def written(line: str) -> str:
    """A file of tests with this line as its twelfth."""
    return (
        "import math\n\nfrom tests.tolerances import ROUNDOFF\n\nPLAIN = 1e-6\nREASON = 1e-6\n"
        '"""What was asked for."""\nBESIDE = 1e-6  # the last digit\ndef test_x(x, y):\n    wide = 1e-6\n    narrow = ROUNDOFF * x\n'
        f"    assert {line}\n"
    )

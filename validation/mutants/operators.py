"""Every small change of a module: a shifted comparison, an inverted sign, a changed constant, a removed statement.

A mutant is identified by its function and its code before and after, not by its line, so edits elsewhere keep it.
Annotations, decorators, docstrings, messages and code for type checkers are not mutated.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

Step = tuple[str, int | None]  # field of a node, and the index if it is a list
Key = tuple[str, str, str, int]  # function, code before, code after, number among equal ones

SITE_MAX = 120  # characters of context around a change
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COMPARED: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_COMPUTED: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
_CALLED = {"min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil"}
_LEFT_OUT = (ast.Raise, ast.Continue, ast.Break, ast.AugAssign, ast.Delete)
_UNTOUCHED = {"annotation", "returns", "decorator_list", "bases", "format_spec", "type_params"}
_SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class Mutant(NamedTuple):
    """One change of a module."""

    function: str  # qualified name, or the module-level table with the key of the entry
    was: str
    now: str
    which: int  # number among equal ones of the function, from 1
    path: tuple[Step, ...]
    node: ast.AST  # the replacement

    @property
    def key(self) -> Key:
        """Return the identity, which matches the mutant with its explanation."""
        return self.function, self.was, self.now, self.which

    def __str__(self) -> str:
        which = f" (number {self.which})" if self.which > 1 else ""
        return f"{self.function}{which}: {self.was}  ->  {self.now}"


def mutants(source: str) -> list[Mutant]:
    """Return all mutants of a module in the order of its lines."""
    tree = ast.parse(source)
    counted: Counter[tuple[str, str, str]] = Counter()
    seen: set[tuple[tuple[Step, ...], str]] = set()
    found = []
    for path, node in _walk(tree, ()):
        for new in _instead(node, path, tree):
            site = _site(tree, path)
            was, scope = _text(_at(tree, site)), _scope(tree, path)
            _put(tree, path, new)
            now = _text(_at(tree, site))
            _put(tree, path, node)
            if was == now or (site, now) in seen:
                continue
            seen.add((site, now))
            key = (scope, was, now)
            counted[key] += 1
            found.append(Mutant(*key, counted[key], path, new))
    return found


def mutated(source: str, mutant: Mutant | None) -> ast.Module:
    """Return the module with one change, or unchanged."""
    tree = ast.parse(source)
    if mutant is not None:
        _put(tree, mutant.path, mutant.node)
    return ast.fix_missing_locations(tree)


def _walk(node: ast.AST, path: tuple[Step, ...]) -> Iterator[tuple[tuple[Step, ...], ast.AST]]:
    """Yield every node that may be changed, with its path."""
    yield path, node
    for field, value in ast.iter_fields(node):
        if field in _UNTOUCHED or (field == "keywords" and isinstance(node, ast.ClassDef)):
            continue
        places: list[tuple[int | None, Any]] = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for place, child in places:
            wording = isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)
            if isinstance(child, ast.AST) and not wording and not _for_readers(child):
                yield from _walk(child, (*path, (field, place)))


def _for_readers(node: ast.AST) -> bool:
    """Return whether a node is a docstring, an import, or only for type checkers or a shell."""
    match node:
        case ast.Expr(value=ast.Constant()) | ast.Import() | ast.ImportFrom() | ast.Assert():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):
            return True
        case ast.Assign(value=ast.Call(func=ast.Name(id="TypeVar"))):
            return True
    return False


def _instead(node: ast.AST, path: tuple[Step, ...], tree: ast.Module) -> Iterator[ast.AST]:
    """Yield the possible replacements of a node."""
    match node:
        case ast.Compare():
            for place, op in enumerate(node.ops):
                for other in _COMPARED[type(op)]:
                    ops = [*node.ops[:place], other(), *node.ops[place + 1 :]]
                    yield ast.Compare(node.left, ops, node.comparators)
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            yield from (_without(node, place) for place in range(len(node.values)))
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
            yield node.operand
        case ast.BinOp() if not _is_type(node):
            yield ast.BinOp(node.left, _COMPUTED[type(node.op)](), node.right)
        case ast.Constant():
            yield from map(ast.Constant, _other_values(node.value))
        case ast.Call(func=ast.Name(id="abs")):
            yield node.args[0]
        case ast.Call(func=ast.Name(id=name)) if name in _CALLED:
            yield ast.Call(ast.Name(_CALLED[name], ast.Load()), node.args, node.keywords)
        case ast.Call(func=ast.Attribute(attr=name) as func) if name in _CALLED:
            yield ast.Call(ast.Attribute(func.value, _CALLED[name], ast.Load()), node.args, node.keywords)
    shifted = isinstance(node, ast.Compare | ast.BoolOp | ast.UnaryOp)
    if path and path[-1][0] in ("test", "ifs") and isinstance(node, ast.expr) and not shifted:
        yield ast.UnaryOp(ast.Not(), node)
    yield from _statements(node, path, tree)


def _statements(node: ast.AST, path: tuple[Step, ...], tree: ast.Module) -> Iterator[ast.AST]:
    match node:
        case ast.Return(value=ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield ast.Return(ast.Constant(None))
        case ast.Return() if _is_last(path, tree):
            return  # a function returns None at its end in any case
        case ast.Return() | ast.Expr(value=ast.Call() | ast.Yield() | ast.YieldFrom() | ast.Await()):
            yield ast.Pass()
        case ast.AugAssign():
            yield ast.AugAssign(node.target, _COMPUTED[type(node.op)](), node.value)
        case ast.Assign(targets=[target]) if isinstance(target, ast.Attribute | ast.Subscript):
            yield ast.Pass()
        case ast.Assign(targets=[ast.Name(id=name)]) if _bound_before(name, path, tree):
            yield ast.Pass()
        case ast.match_case():
            yield ast.match_case(ast.MatchAs(), ast.Constant(False), [ast.Pass()])
    if isinstance(node, _LEFT_OUT):
        yield ast.Pass()


def _without(node: ast.BoolOp, place: int) -> ast.expr:
    rest = [value for number, value in enumerate(node.values) if number != place]
    return rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)


def _is_type(node: ast.expr) -> bool:
    """Return whether a node is a union `A | B` of two classes."""
    match node:
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            return _is_type(left) and _is_type(right)
        case ast.Name(id=name):
            return name[:1].isupper() and not name.isupper()
    return isinstance(node, ast.Constant) and node.value is None


def _other_values(value: object) -> Iterator[Any]:
    """Yield other values of a constant: adjacent numbers, the other truth value, another name."""
    match value:
        case bool():
            yield not value
        case int():
            yield value + 1
            if value > 1:
                yield value - 1
        case float():
            yield from (value * 2, value / 2) if value else (1.0,)
        case bytes():
            yield b"" if value else b"\x01"
        case str() if _NAME.fullmatch(value):
            yield "mutant"


def _bound_before(name: str, path: tuple[Step, ...], tree: ast.Module) -> bool:
    """Return whether a function also binds a name elsewhere; otherwise removing one binding is a NameError."""
    for end in range(len(path) - 1, 0, -1):
        function = _at(tree, path[:end])
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            stored = [n for n in ast.walk(function) if isinstance(n, ast.Name) and n.id == name]
            arguments = [a for a in ast.walk(function.args) if isinstance(a, ast.arg) and a.arg == name]
            return sum(isinstance(n.ctx, ast.Store) for n in stored) + len(arguments) > 1
    return False


def _is_last(path: tuple[Step, ...], tree: ast.Module) -> bool:
    """Return whether a statement is the last one of its function."""
    parent, (field, place) = _at(tree, path[:-1]), path[-1]
    return isinstance(parent, ast.FunctionDef) and field == "body" and place == len(parent.body) - 1


def _at(tree: ast.AST, path: Sequence[Step]) -> Any:
    node: Any = tree
    for field, place in path:
        node = getattr(node, field) if place is None else getattr(node, field)[place]
    return node


def _put(tree: ast.AST, path: tuple[Step, ...], node: ast.AST) -> None:
    *above, (field, place) = path
    parent = _at(tree, above)
    if place is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[place] = node


def _site(tree: ast.Module, path: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return the longest part of one statement around the path that is short enough to read."""
    ends = range(1, len(path) + 1)
    starts = ast.stmt | ast.match_case | ast.excepthandler
    statement = max(end for end in ends if isinstance(_at(tree, path[:end]), starts))
    if hasattr(_at(tree, path[:statement]), "body") and statement < len(path):
        statement += 1  # header of `if`, `for`, `def`
    for end in range(statement, len(path) + 1):
        if len(_text(_at(tree, path[:end]), whole=True)) <= SITE_MAX:
            return path[:end]
    return path


def _text(node: ast.AST, *, whole: bool = False) -> str:
    """Return a part of the module as one line, and only the first line of a compound statement."""
    text = ast.unparse(node)
    if isinstance(node, ast.match_case) or hasattr(node, "body"):
        text = text.strip().partition("\n")[0] if not isinstance(node, ast.IfExp | ast.Lambda) else text
    text = " ".join(text.split())
    return text if whole or len(text) <= SITE_MAX else f"{text[: SITE_MAX - 3]}..."


def _scope(tree: ast.Module, path: tuple[Step, ...]) -> str:
    names: list[str] = []
    within_function = False
    for end in range(1, len(path) + 1):
        node, parent = _at(tree, path[:end]), _at(tree, path[: end - 1])
        within_function = within_function or isinstance(parent, ast.FunctionDef)
        if isinstance(node, _SCOPES):
            names.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(parent, ast.Module | ast.ClassDef):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names.append(", ".join(map(ast.unparse, targets)))
        elif isinstance(parent, ast.Dict) and not within_function:
            key = parent.keys[path[end - 1][1] or 0]
            names[-1] += f"[{ast.unparse(key)}]" if key else ""
    return ".".join(names) or "module"

"""Count the multiply-adds of a function in SPIR-V, by following its calls with numbers that have no value.

The charges are those that ``replay.counting`` states, scalar by scalar, of what a compiler made of the text:

- a multiplication, a division, a square root or its reciprocal: 1 each component;
- an addition or subtraction: 1 each component, but 0 where it meets a product, or a sum of nothing but
  products, that has met no addition yet: the two fuse;
- so a dot product of n is n, a matrix times a vector is rows × columns, a cross product is 6, and each of
  these results is a sum of products;
- multiplications by a sign (a choice between 1 and −1, or the frame's handedness), negations, comparisons,
  choices, loads and stores: 0. Both sides of a choice are charged.

Nothing is simplified first: not the products by 1 and 0 that a compiler might drop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

Value: TypeAlias = Any
"""A Number, or a tuple of values: vectors, matrices column by column, arrays, structs."""

FRAME, HANDEDNESS = "skinbake_Frame", 3


class Number:
    """A scalar: whether it is ±1, and whether an addition can still fuse with the products it is made of."""

    __slots__ = ("fuses", "is_sign", "literal")

    def __init__(self, *, fuses: bool = False, is_sign: bool = False, literal: float | None = None) -> None:
        self.fuses, self.is_sign, self.literal = fuses, is_sign, literal


@dataclass(slots=True)
class Variable:
    """Memory of one function."""

    value: Value


@dataclass(frozen=True, slots=True)
class Pointer:
    """A place within a variable."""

    variable: Variable
    path: tuple[int, ...] = ()

    def load(self) -> Value:
        value = self.variable.value
        for step in self.path:
            value = value[step]
        return value

    def store(self, value: Value) -> None:
        self.variable.value = _replaced(self.variable.value, self.path, value)


def _replaced(whole: Value, path: tuple[int, ...], value: Value) -> Value:
    if not path:
        return value
    first, *rest = path
    return tuple(
        _replaced(part, tuple(rest), value) if number == first else part for number, part in enumerate(whole)
    )


@dataclass(frozen=True, slots=True)
class Instruction:
    """One line: its result's id or "", its name, what follows."""

    result: str
    name: str
    operands: tuple[str, ...]


@dataclass(slots=True)
class Function:
    """Parameters with their types, and the instructions of the body in order."""

    parameters: list[tuple[str, str]] = field(default_factory=list)
    body: list[Instruction] = field(default_factory=list)


class Module:
    """A module as ``spirv-dis --raw-id`` writes it."""

    def __init__(self, disassembly: str) -> None:
        self._names: dict[str, str] = {}
        self._types: dict[str, Instruction] = {}
        self._globals: dict[str, Value] = {}
        self._integers: dict[str, int] = {}
        self._functions: dict[str, Function] = {}
        current: Function | None = None
        for instruction in _instructions(disassembly):
            result, name, operands = instruction.result, instruction.name, instruction.operands
            if name == "OpName":
                self._names[operands[0]] = operands[1].strip('"')
            elif name.startswith("OpType"):
                self._types[result] = instruction
            elif name in ("OpConstant", "OpConstantComposite", "OpConstantTrue", "OpConstantFalse"):
                self._constant(instruction)
            elif name == "OpFunction":
                current = self._functions.setdefault(result, Function())
            elif name == "OpFunctionParameter" and current:
                current.parameters.append((result, operands[0]))
            elif name == "OpFunctionEnd":
                current = None
            elif current:
                current.body.append(instruction)
            elif name == "OpVariable":  # an input, an output or a uniform block
                self._globals[result] = self.fresh(operands[0])

    def functions(self) -> list[str]:
        """Return the names of all functions, without their parameters."""
        return [self._names[key].partition("(")[0] for key in self._functions]

    def multiply_adds(self, name: str) -> int:
        """Return the cost of one call of a function, whatever its arguments."""
        (key,) = [key for key in self._functions if self._names[key].partition("(")[0] == name]
        counter = _Counter(self)
        counter.call(key, [self.fresh(kind) for _, kind in self._functions[key].parameters])
        return counter.total

    def function(self, key: str) -> Function:
        """Return a function by its id."""
        return self._functions[key]

    def constants(self) -> dict[str, Value]:
        """Return the values of the module's constants by id."""
        return dict(self._globals)

    def integer(self, key: str) -> int:
        """Return an integer constant by its id."""
        return self._integers[key]

    def is_vector(self, kind: str) -> bool:
        """Tell whether a type is a vector."""
        return self._types[kind].name == "OpTypeVector"

    def fresh(self, kind: str) -> Value:
        """Return an unknown value of a type; of a frame the handedness is a sign."""
        name, operands = self._types[kind].name, self._types[kind].operands
        if name == "OpTypePointer":
            return Pointer(Variable(self.fresh(operands[1])))
        if name in ("OpTypeVector", "OpTypeMatrix", "OpTypeArray"):
            count = self._integers[operands[1]] if name == "OpTypeArray" else int(operands[1])
            return tuple(self.fresh(operands[0]) for _ in range(count))
        if name == "OpTypeStruct":
            members = [self.fresh(member) for member in operands]
            if self._names.get(kind) == FRAME:
                members[HANDEDNESS] = Number(is_sign=True)
            return tuple(members)
        return Number()

    def _constant(self, instruction: Instruction) -> None:
        kind, *rest = instruction.operands
        if instruction.name == "OpConstantComposite":
            self._globals[instruction.result] = tuple(self._globals[part] for part in rest)
        elif instruction.name == "OpConstant" and self._types[kind].name == "OpTypeFloat":
            self._globals[instruction.result] = Number(literal=float(rest[0]))
        else:
            self._globals[instruction.result] = Number()
            if instruction.name == "OpConstant":
                self._integers[instruction.result] = int(rest[0])


def _instructions(disassembly: str) -> Iterable[Instruction]:
    for line in disassembly.splitlines():
        words = line.split()
        if not words or words[0].startswith(";"):
            continue
        if len(words) > 2 and words[1] == "=":
            yield Instruction(words[0], words[2], tuple(words[3:]))
        else:
            yield Instruction("", words[0], tuple(words[1:]))


FREE = {"OpLabel", "OpBranch", "OpBranchConditional", "OpSelectionMerge", "OpReturn", "OpLogicalAnd"}
COMPARED = "OpFOrd"
"""How the names of comparisons begin."""


class _Counter:
    """Runs functions of a module and charges them."""

    def __init__(self, module: Module) -> None:
        self._module, self.total = module, 0

    def call(self, key: str, arguments: Sequence[Value]) -> Value:
        """Run a function; the arms of a choice one after the other, as they stand."""
        function = self._module.function(key)
        values = self._module.constants()
        values.update(zip((name for name, _ in function.parameters), arguments, strict=True))
        for instruction in function.body:
            name, operands = instruction.name, instruction.operands
            if name == "OpReturnValue":
                return values[operands[0]]
            if name == "OpStore":
                values[operands[0]].store(values[operands[1]])
            elif name in FREE or name.startswith(COMPARED):
                values[instruction.result] = Number()
            else:
                values[instruction.result] = self._result(name, operands[0], operands[1:], values)
        return None

    def _result(self, name: str, kind: str, operands: Sequence[str], values: dict[str, Value]) -> Value:
        if name == "OpVariable":
            return self._module.fresh(kind)
        if name == "OpFunctionCall":
            return self.call(operands[0], [values[operand] for operand in operands[1:]])
        if name == "OpExtInst":
            return self._extended(operands[1], [values[operand] for operand in operands[2:]])
        if name in (
            "OpAccessChain",
            "OpLoad",
            "OpCompositeExtract",
            "OpVectorShuffle",
            "OpCompositeConstruct",
        ):
            return self._moved(name, kind, operands, values)
        return self._arithmetic(name, [values[operand] for operand in operands])

    def _moved(self, name: str, kind: str, operands: Sequence[str], values: dict[str, Value]) -> Value:
        """Return the result of an instruction that computes nothing."""
        value = values[operands[0]]
        if name == "OpLoad":
            return value.load()
        if name == "OpAccessChain":
            steps = tuple(self._module.integer(index) for index in operands[1:])
            return Pointer(value.variable, value.path + steps)
        if name == "OpCompositeExtract":
            for step in operands[1:]:
                value = value[int(step)]
            return value
        if name == "OpVectorShuffle":
            both = (*value, *values[operands[1]])
            return tuple(both[int(index)] for index in operands[2:])
        parts = [values[operand] for operand in operands]
        return tuple(_flat(parts)) if self._module.is_vector(kind) else tuple(parts)

    def _arithmetic(self, name: str, given: Sequence[Value]) -> Value:
        rules: dict[str, Callable[..., Value]] = {
            "OpFMul": lambda a, b: _each(self._product, a, b),
            "OpFAdd": lambda a, b: _each(self._sum, a, b),
            "OpFSub": lambda a, b: _each(self._sum, a, b),
            "OpFDiv": lambda a, b: _each(self._opaque, a, b),
            "OpFNegate": lambda a: a,
            "OpSelect": lambda _, a, b: _each(_either, a, b),
            "OpDot": self._dot,
            "OpVectorTimesScalar": lambda a, b: tuple(self._product(part, b) for part in a),
            "OpMatrixTimesScalar": lambda a, b: tuple(tuple(self._product(x, b) for x in part) for part in a),
            "OpMatrixTimesVector": lambda a, b: tuple(self._dot(row, b) for row in zip(*a, strict=True)),
            "OpOuterProduct": lambda a, b: tuple(tuple(self._product(x, part) for x in a) for part in b),
        }
        return rules[name](*given)

    def _extended(self, name: str, given: Sequence[Value]) -> Value:
        if name in ("Sqrt", "InverseSqrt"):
            return self._opaque(given[0])
        if name != "Cross":
            raise KeyError(name)
        (a, b), pairs = given, ((1, 2), (2, 0), (0, 1))
        return tuple(self._sum(self._product(a[i], b[j]), self._product(a[j], b[i])) for i, j in pairs)

    def _dot(self, a: Sequence[Number], b: Sequence[Number]) -> Number:
        total, *rest = [self._product(left, right) for left, right in zip(a, b, strict=True)]
        for term in rest:
            total = self._sum(total, term)
        return total

    def _product(self, a: Number, b: Number) -> Number:
        if a.is_sign or b.is_sign:
            return b if a.is_sign else a
        self.total += 1
        return Number(fuses=True)

    def _sum(self, a: Number, b: Number) -> Number:
        if not (a.fuses or b.fuses):
            self.total += 1
        found = Number(fuses=a.fuses and b.fuses)
        a.fuses = b.fuses = False
        return found

    def _opaque(self, *given: Number) -> Number:
        self.total += 1
        return Number()


def _each(operation: Callable[[Number, Number], Number], a: Value, b: Value) -> Value:
    if isinstance(a, tuple):
        return tuple(_each(operation, left, right) for left, right in zip(a, b, strict=True))
    return operation(a, b)


def _either(a: Number, b: Number) -> Number:
    literals = {a.literal, b.literal}
    return Number(is_sign=literals == {1.0, -1.0})


def _flat(parts: Iterable[Value]) -> Iterable[Number]:
    for part in parts:
        if isinstance(part, tuple):
            yield from part
        else:
            yield part

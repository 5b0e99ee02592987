"""Every public function and class of `import ssmr_torch` says the type of each argument and of its result."""

import inspect
from functools import cached_property

import pytest

import ssmr_torch as ssmr

SPECIAL = ("__init__", "__call__", "__len__", "__getitem__")


def functions(offered):
    """The functions behind a name of the face: itself, or the public methods and properties of a class."""
    if inspect.isfunction(offered):
        yield inspect.unwrap(offered)
        return
    for name, member in vars(offered).items():
        member = member.fget if isinstance(member, property) else member
        member = member.func if isinstance(member, cached_property) else getattr(member, "__func__", member)
        written = inspect.isfunction(member) and member.__code__.co_filename != "<string>"  # not by dataclass
        if written and (not name.startswith("_") or name in SPECIAL):
            yield inspect.unwrap(member)


def untyped(function):
    """Names of the arguments without a type, and "return"."""
    parameters = list(inspect.signature(function).parameters.values())
    own = 1 if parameters and parameters[0].name in ("self", "cls") else 0
    found = [parameter.name for parameter in parameters[own:] if parameter.annotation is inspect.Parameter.empty]
    return found + ["return"] * ("return" not in function.__annotations__ and function.__name__ != "__init__")


@pytest.mark.parametrize("name", [name for name in ssmr.__all__ if not inspect.ismodule(getattr(ssmr, name))])
def test_every_argument_and_result_has_a_type(name):
    assert {each.__qualname__: untyped(each) for each in functions(getattr(ssmr, name)) if untyped(each)} == {}


def test_what_has_no_type_is_found():
    class Offered:
        def method(self, given, known: int):
            """No type of given, and none of the result."""

    assert [untyped(each) for each in functions(Offered)] == [["given", "return"]]

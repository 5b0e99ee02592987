"""Claims about the ranges of settings: what fits, what is said of what does not, and that every number has one."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.checked_arguments import checked, ranges_of
from ssmr_torch.command_ranges import OF_ANY, OF_COMMANDS
from ssmr_torch.configuration import as_in_a_job, folder, options, plain_values
from ssmr_torch.configuration_check import check_values, declared
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.keywords import configurable
from ssmr_torch.quantities import ADDRESS, RIDGE
from ssmr_torch.ranges import ByName, Each, Either, Number, OneOf, OneOrEach, OrNone, PathText, Text, Truth, Whole

OBJECTS = ("actuator", "observer", "obstacles", "plant", "view")  # null or empty where there is none


@pytest.mark.parametrize(("range_", "good", "bad"), [
    (Whole(0, 9), [0, 9, 5.0, np.int64(3), np.array(2)], [-1, 10, 1.5, True, np.nan, np.inf, "3", [3], None, 10**400]),
    (Number(0.0, 1.0), [0, 1, 0.5, np.float32(0.25)], [-1e-300, 1.5, np.nan, np.inf, 1e300, True, "0.5", [0.5], {}]),
    (Number(0.0, 1.0, above=True), [1e-300, 1.0], [0, 0.0, -1]),
    (Number(-1.0, 1.0, infinite=True), [np.inf, -np.inf, "inf", "-inf", 0], [np.nan, 2.0, "1", "nan"]),
    (Truth(), [True, np.False_], [1, 0, "true", None]),
    (Text(), ["a"], ["", "  ", 3, None, ["a"], "a\0b", "a" * 5000]),
    (PathText(), ["a.h5", Path("b")], ["", 3, None]),
    (OneOf("a", 1), ["a", 1], ["b", 1.0, True, None, ["a"]]),
    (OrNone(Whole(1, 2)), [None, 1], [0, "null"]),
    (Each(Whole(0, 5), 1, 2), [[1], (1, 2), np.array([0, 5])], [[], [1, 2, 3], [6], "1", 1, {0: 1}, None]),
    (ByName(Whole(0, 5)), [{"a": 1}, {}], [{"a": 9}, {1: 1}, [1], None]),
    (Either(Whole(0, 5), Text()), [3, "gap"], [9, None]),
    (OneOrEach(Number(0.0, 1.0), "input"), [0.5, [0.1, 0.2]], [2.0, [0.1, np.nan], [], "a"]),
    (RIDGE, [0.0, 1e-3, [0.0, 1e-3], {"default": [0.0]}], [-1.0, np.nan, {"default": -1.0}, "ridge", None]),
    (ADDRESS, ["tcp://*:5555", "tcp://127.0.0.1:*", "tcp://[::1]:1", "ipc:///tmp/x"],
     ["tcp://*:99999", "tcp://*:0", "tcp://*", "5555", 5555, "", "http://a:80"])])
def test_a_range_takes_what_fits_and_refuses_what_does_not_in_one_sentence(range_, good, bad):
    for value in good:
        range_("setting", value)
    for value in bad:
        with pytest.raises(ValueError, match="setting") as refused:
            range_("setting", value)
        assert "expected" in str(refused.value) and "\n" not in str(refused.value) and len(str(refused.value)) < 300


def test_a_refusal_gives_the_value_its_unit_and_the_place_in_a_list():
    with pytest.raises(ValueError, match=r"^period is nan s; expected a number from 1e-06 to 100 s$"):
        PredictiveControlSettings(period=float("nan"))
    with pytest.raises(ValueError, match=r"^input_weight\[1\] is -1\.0; expected a number from"):
        PredictiveControlSettings(input_weight=[1.0, -1.0])


def test_checked_arguments_are_found_by_place_and_by_name_and_whole_numbers_become_integers():
    @checked(count=Whole(0, 5), share=Number(0.0, 1.0))
    def work(name, count, share=0.5):
        return count, share

    assert work("a", 2.0) == (2, 0.5) and type(work("a", count=2.0)[0]) is int
    assert list(inspect.signature(work).parameters) == ["name", "count", "share"]
    for given, named in ((("a", 6), {}), (("a",), {"count": 1.5}), (("a", 1, 2.0), {}), (("a", 1), {"share": "b"})):
        with pytest.raises(ValueError, match="expected"):
            work(*given, **named)
    with pytest.raises(TypeError, match="takes no size"):
        checked(size=Whole(0, 1))(work)


def test_ranges_of_a_class_are_those_of_its_bases_and_of_what_it_hands_its_keywords_on_to():
    class Base:
        @checked(size=Whole(0, 5))
        def __init__(self, size=1):
            pass

    class Inherits(Base):
        @configurable(Base)
        @checked(share=Number(0.0, 1.0))
        def __init__(self, share=0.5, **more):
            super().__init__(**more)

    assert set(ranges_of(Inherits)) == {"size", "share"}


def compositions():
    """Every command as it is, with every model, plant, task, rig, excitation, fit and controller."""
    for path in sorted(folder().glob("*.yaml")):
        if path.stem != "directories":
            yield path.stem, []
    for command, group in (("train", "model"), ("train", "fit"), ("train", "derivative"), ("collect", "plant"),
                           ("collect", "rig"), ("collect", "excitation"), ("control", "task"), ("train", "search")):
        yield from (of_a_group(command, f"{group}={option}") for option in options(group))
    yield from (of_a_group("control", f"observer@controller.observer={option}") for option in options("observer"))
    yield from (of_a_group("control", f"controller={robot}/{option}") for robot in ("trunk", "diamond")
                for option in options(f"controller/{robot}"))
    yield from (of_a_group("train", "robot=diamond", f"model={option}", "settings=found")
                for option in ("ssmr", "tpwl", "dmd"))


def of_a_group(command, *overrides):
    return pytest.param(command, list(overrides), marks=pytest.mark.slow)


def bare(node, ranges, key=""):
    """Keys of numbers, texts and truth values in a configuration for which no range is declared."""
    own = declared(node["_target_"])[0] if "_target_" in node else None
    for name, value in node.items():
        full = f"{key}.{name}" if key else name
        if name.startswith("_") or full in ("hydra", "found", "preset") or (own if own is not None else ranges).get(
                name if own is not None else full) or name in OBJECTS:
            continue
        if isinstance(value, dict):
            yield from bare(value, ranges, full)
        elif isinstance(value, list):
            for place, each in enumerate(value):
                yield from bare(each, ranges, f"{full}[{place}]") if isinstance(each, dict) else [full]
        else:
            yield full


@pytest.mark.parametrize(("command", "overrides"), list(compositions()), ids=lambda value: str(value)[:60])
def test_every_setting_has_a_range_and_every_configuration_of_ours_lies_within(command, overrides, tmp_path):
    values = plain_values(as_in_a_job(command, overrides, tmp_path))
    check_values(command, values)
    assert sorted(set(bare(values, OF_ANY | OF_COMMANDS.get(command, {})))) == []

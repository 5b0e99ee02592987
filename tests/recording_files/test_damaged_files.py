"""A damaged file of any format is refused in a short sentence, or read: nothing else is raised."""

import importlib.util
import random
import warnings
from pathlib import Path

import pytest

from ssmr_torch.recording_files.reading import read_tables

SPEC = importlib.util.spec_from_file_location("contract", Path(__file__).with_name("test_contract.py"))
contract = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(contract)
SLOW = ("bag", "bag_of_mcap", "one_file_of_mcap", "parquet")


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Cut, with flipped bits, with other bytes among its own, or with another byte near its beginning."""
    made = bytearray(data)
    place = chance.randrange(len(made))
    kind = chance.randrange(4)
    if kind == 0:
        return bytes(made[:max(place, 1)])
    if kind == 1:
        for _ in range(chance.randrange(1, 6)):
            made[chance.randrange(len(made))] ^= 1 << chance.randrange(8)
    elif kind == 2:
        made[place:place + chance.randrange(1, 50)] = chance.randbytes(chance.randrange(50))
    else:
        made[place % 1000] = chance.randrange(256)
    return bytes(made)


def outcomes(write, folder, count, seed=0):
    path, _ = write(folder)
    path = path if path.is_file() else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    data, chance, refused = path.read_bytes(), random.Random(seed), []
    for _ in range(count):
        path.write_bytes(damaged(data, chance))
        try:
            read_tables(path)
        except ValueError as error:
            refused.append(str(error))
    return refused


@pytest.mark.parametrize("write", contract.WRITERS)
def test_a_damaged_file_is_refused_in_a_short_sentence_or_read(write, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused = outcomes(write, tmp_path, 6 if write.__name__ in SLOW else 15)
    assert refused and max(map(len, refused)) < 400


@pytest.mark.slow
@pytest.mark.parametrize("write", [each for each in contract.WRITERS if each.__name__ not in SLOW])
def test_of_a_hundred_damages_each_is_refused_or_read(write, tmp_path):
    assert max(map(len, outcomes(write, tmp_path, 100, seed=1))) < 400


def test_a_device_is_refused_before_it_is_read():
    with pytest.raises(ValueError, match="/dev/zero is no file but a device or a pipe"):
        read_tables("/dev/zero")

"""Clocks of one run: units, dates, frame numbers, order, bursts and gaps, each with the seconds that are right."""

import numpy as np
import pytest

from ssmr_torch.recording_clocks.clock_rules import ClockRules
from ssmr_torch.recording_clocks.seconds import clock_of
from ssmr_torch.recording_files.table import Table

K = np.arange(200)
EVEN = 0.01 * K


def clock(given, /, motion=None, more=None, **rules):
    """The clock of a run of smooth motion with these stamps, in s."""
    stamps = np.asarray(given)
    y = np.sin(0.05 * np.arange(len(stamps))) if motion is None else np.asarray(motion)
    return clock_of(Table({"t": stamps, "x": y} | (more or {})), "m", "m.csv",
                    ClockRules(**{"time": "t", "outputs": ("x",)} | rules))


def of_frames(numbers, rate=100, **options):
    return clock(numbers, time=None, frame="t", rate=rate, **options)


def said(found):
    return " ".join(str(note) for note in found.notes)


def test_a_clean_clock_is_its_stamps_to_the_last_bit_and_nothing_is_said():
    for stamps in (EVEN, EVEN + 1.7e9, np.round(EVEN + 3.1, 2)):
        found = clock(stamps)
        np.testing.assert_array_equal(found.time, stamps)
        np.testing.assert_array_equal(found.rows, K)
        assert found.notes == ()


# Units

@pytest.mark.parametrize(("unit", "stamps"), [
    ("ns", 1_700_000_000_000_000_000 + 10_000_000 * K), ("us", 1_700_000_000_000_000 + 10_000 * K), ("ms", 10 * K),
    ("us", 10_000 * K), ("ns", 7 + 10_000_000 * K), ("min", EVEN / 60), ("d", 45_000 + EVEN / 86400)])
def test_every_unit_gives_hundredths_of_a_second(unit, stamps):
    found = clock(stamps, unit=unit)
    tolerance = 1e-15 if stamps.dtype.kind == "i" else 1e-6
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=tolerance * 1e3)
    assert found.notes == ()


def test_nanoseconds_of_an_epoch_keep_every_digit():
    stamps = 1_700_000_000_000_000_000 + 10_000_001 * K
    found = clock(stamps, unit="ns")
    np.testing.assert_array_equal(found.time, 1e-9 * (10_000_001 * K))
    assert found.origin == 1_700_000_000_000_000_000


@pytest.mark.parametrize(("stamps", "likely"), [
    (1_700_000_000_000_000_000 + 10_000_000 * K, "look like ns"), (10_000 * K + 7, "look like us"),
    (10 * K, "look like ms"), (45_000 + EVEN / 86400, "look like d"), (738_000 + EVEN / 86400, "look like d"),
    (5 * K, "ms, or like frame numbers")])
def test_a_wrong_unit_is_refused_with_the_likely_one(stamps, likely):
    with pytest.raises(ValueError, match=likely):
        clock(stamps)


# Dates

def texts(form):
    return np.array([form.format(ms=10 * k % 1000, s=10 * k // 1000) for k in range(200)], dtype=object)


@pytest.mark.parametrize("form", [
    "2024-03-31T12:00:{s:02d}.{ms:03d}Z", "2024-03-31 12:00:{s:02d},{ms:03d}", "31.03.2024 12:00:{s:02d}.{ms:03d}",
    "03/31/2024 12:00:{s:02d}.{ms:03d} PM", "31-Mar-2024 12:00:{s:02d}.{ms:03d}", "12:00:{s:02d}.{ms:03d}",
    "Mar 31, 2024 12:00:{s:02d}.{ms:03d}", "20240331T1200{s:02d}.{ms:03d}", "59:{s:02d}.{ms:03d}",
    "2024-03-31T12:00:{s:02d}.{ms:03d}000000+02:00", "2024-03-31 12:00:{s:02d}.{ms:03d} CET"])
def test_dates_are_read_as_people_and_programs_write_them(form):
    found = clock(texts(form))
    np.testing.assert_allclose(found.time - found.time[0], EVEN, atol=1e-12)
    assert found.notes == ()


def test_summer_time_midnight_and_datetimes_make_no_gap():
    start = np.datetime64("2024-03-31T00:59:59.000", "ms")
    instants = start + 10 * K.astype("timedelta64[ms]")
    local = [f"{each + np.timedelta64(1 if each < np.datetime64('2024-03-31T01:00') else 2, 'h')}"
             f"{'+01:00' if each < np.datetime64('2024-03-31T01:00') else '+02:00'}" for each in instants]
    night = [str(np.datetime64("2024-03-31T23:59:59.500", "ms") + 10 * k)[11:] for k in K.astype("timedelta64[ms]")]
    for stamps in (np.array(local, dtype=object), instants, np.array(night, dtype=object)):
        found = clock(stamps)
        np.testing.assert_allclose(found.time - found.time[0], EVEN, atol=1e-12)
        assert found.notes == ()


def test_dates_of_which_day_and_month_cannot_be_told_apart_are_refused():
    with pytest.raises(ValueError, match="day and month cannot be told apart.*2024-03-31"):
        clock(np.array(["01/02/2024 12:00:00", "03/04/2024 12:00:00", "05/04/2024 12:00:00"], dtype=object))


def test_what_is_no_time_is_refused_with_its_row():
    with pytest.raises(ValueError, match="row 1 .*holds 'soon'; expected a number, or a date"):
        clock(np.array(["2024-03-31T12:00:00", "soon", "2024-03-31T12:00:01"], dtype=object))


def test_seconds_and_nanoseconds_in_two_columns_and_a_date_beside_a_time_are_one_clock():
    total = 1_700_000_000_990_000_000 + 10_000_000 * K
    found = clock(total // 10**9, more={"ns": total % 10**9}, time=("t", "ns"))
    np.testing.assert_allclose(found.time, EVEN, atol=1e-12)
    day = np.array(["2024-03-31"] * 200, dtype=object)
    found = clock(day, more={"clock": texts("12:00:{s:02d}.{ms:03d}")}, time=("t", "clock"))
    np.testing.assert_allclose(found.time - found.time[0], EVEN, atol=1e-12)


# Frames

def test_frame_numbers_are_suspected_and_never_called_milliseconds():
    with pytest.raises(ValueError, match="whole numbers in steps of 1: frames.*columns.frame.*rate") as refused:
        clock(K)
    assert "look like" not in str(refused.value)
    assert "frames?" in said(clock(K, unit="ms")) and clock(K + 5, unit="ms").notes == ()


def test_missing_frame_numbers_are_missing_frames():
    kept = np.delete(K, [50, 100, 150])
    found = of_frames(kept)
    np.testing.assert_allclose(found.time, 0.01 * kept, atol=1e-12)
    assert "3 samples are absent, before rows 50, 99 and 148; bridged" in said(found)


def test_counters_of_few_bits_are_counted_on_where_the_motion_goes_on():
    found = of_frames((K + 200) % 256)
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=1e-12)
    assert "begins again at row 56" in said(found)
    stamps = (10_000 * K + 2**32 - 500_000) % 2**32
    np.testing.assert_allclose(np.diff(clock(stamps, unit="us").time), 0.01, atol=1e-12)


def test_a_sub_frame_is_a_part_of_a_frame():
    found = of_frames(K // 2, more={"Sub Frame": K % 2}, rate=50)
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=1e-12)


@pytest.mark.parametrize(("rules", "message"), [
    ({"time": None, "frame": "t"}, "give their rate in Hz"),
    ({"time": None, "frame": "t", "rate": 1e6}, "correct rate"), ({"time": None}, "no clock: name its column of time"),
    ({"time": "when"}, "no numeric column"), ({"stamps": "odd"}, "stamps is 'odd'; expected one of"),
    ({"same_stamp": "both"}, "same_stamp is 'both'"), ({"rate": 0.0}, "rate is 0.0; expected frames per second")])
def test_wrong_rules_are_refused(rules, message):
    with pytest.raises(ValueError, match=message):
        clock(K, **rules)


def test_an_unread_column_that_counts_frames_tells_that_some_are_absent():
    kept = np.delete(K, [50, 51])
    found = clock(np.zeros(198), more={"number": kept}, time=None, interval=0.01, outputs=("x", "t"))
    assert "column 'number' counts frames, of which 2 are absent, before row 50" in said(found)
    assert clock(np.zeros(200), more={"number": K}, time=None, interval=0.01, outputs=("x", "t")).notes == ()


# Order

def test_rows_that_are_written_twice_are_dropped_and_said():
    for twice, words in ((np.r_[:100, 99:200], "row 100 repeats"), (np.r_[:100, 90:200], "rows 100..109 repeat")):
        found = clock(EVEN[twice], np.sin(0.05 * K)[twice])
        np.testing.assert_array_equal(found.time, EVEN)
        assert words in said(found)


@pytest.mark.parametrize("order", [[10, 11], [10, 11, 12], [10, 11, 12, 13, 14, 15, 16, 17, 18, 19]])
def test_rows_out_of_order_are_sorted_and_said(order):
    rows = K.copy()
    rows[order] = rows[order[::-1]]
    found = clock(EVEN[rows])
    np.testing.assert_array_equal(found.time, EVEN)
    np.testing.assert_array_equal(rows[found.rows], K)
    assert "not in the order of time; sorted" in said(found)


def test_rows_that_stand_newest_first_are_turned_around():
    found = clock(EVEN[::-1])
    np.testing.assert_array_equal(found.time, EVEN)
    assert found.rows[0] == 199 and "newest first" in said(found)


@pytest.mark.parametrize("stamp", [0.985, 1.015, 0.99, 1.3, 0.0, 70.0])
def test_one_wrong_stamp_is_refused_with_the_remedy_and_even_stamps_mend_it(stamp):
    stamps = EVEN.copy()
    stamps[100] = stamp
    with pytest.raises(ValueError, match="at row 100 .*the rows around it say 1 s; correct the stamp.*stamps: even"):
        clock(stamps)
    np.testing.assert_allclose(clock(stamps, stamps="even").time, EVEN, atol=1e-9)


def test_a_stamp_between_its_neighbours_that_is_off_is_said():
    stamps = EVEN.copy()
    stamps[100] = 0.994
    assert "the stamp of row 100 is up to 6 ms early" in said(clock(stamps))


def test_rows_of_one_stamp_and_other_values_are_refused_or_one_is_kept():
    stamps = np.insert(EVEN, 100, EVEN[99])
    with pytest.raises(ValueError, match="time repeats at row 100 .*same_stamp: first or last"):
        clock(stamps)
    assert 100 not in clock(stamps, same_stamp="first").rows and 99 not in clock(stamps, same_stamp="last").rows


@pytest.mark.parametrize("stamps", [np.r_[EVEN[:100], EVEN[:100]], np.r_[EVEN[:190], EVEN[:10]],
                                    np.r_[EVEN[:10], EVEN[:190]], np.r_[EVEN[50:150], EVEN[:100]]])
def test_where_the_clock_starts_again_another_run_begins(stamps):
    found = clock(stamps)
    begins = int(np.argmin(np.diff(stamps))) + 1
    steps = np.diff(found.time)
    assert (steps > 0).all() and np.flatnonzero(steps > 0.03).tolist() == [begins - 1]
    assert f"at row {begins}: another run begins there" in said(found)


# Few digits and bursts

def test_a_clock_of_too_few_digits_is_refused_with_the_remedy():
    with pytest.raises(ValueError, match="all 200 rows share a stamp.*too few digits; give sampling_time"):
        clock(np.full(200, 1.73234e9))
    with pytest.raises(ValueError, match="100 rows share a stamp.*too few digits; give sampling_time.*100 Hz"):
        clock(1_732_340_000 + np.arange(1000) // 100)


@pytest.mark.parametrize(("period", "size", "within", "words"), [
    (0.04, 4, 0.0005, "arrive in fours"), (0.1, 10, 0.0001, "arrive in tens"), (0.03, 3, 0.001, "arrive in threes"),
    (0.04, 4, 0.0, "4 rows share a stamp"), (1.0, 100, 0.0, "100 rows share a stamp")])
def test_bursts_are_refused_with_the_mean_rate_and_spread_evenly(period, size, within, words):
    k = np.arange(1000)
    stamps = period * (k // size) + within * (k % size)
    with pytest.raises(ValueError, match=f"{words}.*") as refused:
        clock(stamps)
    assert "stamps: even" in str(refused.value) and "Hz" in str(refused.value)
    found = clock(stamps, stamps="even")
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=1e-6)
    assert "spread evenly" in said(found)


def test_even_stamps_keep_gaps():
    k = np.r_[:400, 500:1000]
    found = clock(0.04 * (k // 4) + 0.0005 * (k % 4), stamps="even")
    steps = np.diff(found.time)
    assert np.flatnonzero(steps > 0.03).tolist() == [399] and steps[399] == pytest.approx(1.01, abs=1e-3)


def test_stamps_that_are_even_already_stay_as_they_are():
    found = clock(EVEN, stamps="even")
    np.testing.assert_array_equal(found.time, EVEN)
    assert found.notes == ()


# Gaps

@pytest.mark.parametrize(("lost", "words"), [(1, "1 sample is absent, before row 100; bridged"),
                                             (20, "20 samples are missing before row 100, a gap of 0.21 s"),
                                             (60, "60 samples are missing before row 100, a gap of 0.61 s")])
def test_gaps_are_said_with_their_row_and_length(lost, words):
    assert words in said(clock(np.delete(EVEN, np.arange(100, 100 + lost))))


def test_jitter_is_said_where_it_is_large():
    random = np.random.default_rng(0)
    assert clock(EVEN + random.uniform(-2e-4, 2e-4, 200)).notes == ()
    assert "deviate by" in said(clock(EVEN + random.uniform(-2e-3, 2e-3, 200)))


def test_rows_without_a_stamp_keep_their_places():
    stamps = EVEN.copy()
    stamps[[50, 51]] = np.nan
    found = clock(stamps)
    np.testing.assert_array_equal(found.rows, K)
    assert np.isnan(found.time[[50, 51]]).all()

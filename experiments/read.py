"""Files of recordings → what is in them (format, runs, columns, units, rate), and a first card that a person corrects.

ssmr read FILE…
"""

from pathlib import Path

from ssmr_torch.entry_point import entry_point, save_result
from ssmr_torch.result_files import save_text


@entry_point("read")
def main(config, directory):
    from ssmr_torch.data.card_reader import custom
    from ssmr_torch.data.file_contents import contents
    from ssmr_torch.data.first_card import first_card

    card = Path(config.card or directory / "card.yaml")
    if card.exists():
        raise FileExistsError(f"{card} is there already and may have been corrected; give another place: card=FILE")
    found = contents(list(config.files))
    print(found)
    save_text(directory / "contents.txt", f"{found}\n")
    save_text(card, first_card(found, card.parent))
    print(f"\n{card.read_text(encoding='utf-8')}\n{card}")
    try:
        loaded = custom(card)
        said = f"the card loads {len(loaded)} runs; correct its guesses, then: ssmr check recordings={card}"
    except (ValueError, OSError) as error:
        said = f"the card needs your corrections: {error}"
    print(said)
    save_result(directory, {"runs": float(len(found.runs)), "unreadable": float(len(found.unreadable))})
    return float(len(found.unreadable))


if __name__ == "__main__":
    main()

"""The folder that a commissioning leaves: what was done with which figures, and the files of every step."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.output_file import write_file
from servo_msgs_py.text_file import TextFileError, parse_json, read_text

from servo_bridge.commissioning.figure import Figure

PROGRESS: Final = "commissioning.json"


class PackError(Exception):
    """A folder cannot be continued; the text has reason and remedy."""


@dataclass(frozen=True)
class Done:
    """Result of a step."""

    figures: Sequence[Figure] = ()
    texts: Sequence[str] = ()  # results that are no numbers, one sentence each
    pictures: Sequence[str] = ()  # names of files in the folder


@dataclass
class Pack:
    """Results in a folder; saved after every step, so that the sequence can be continued.

    Parameters
    ----------
    folder : Path
        Is created.
    subject : mapping
        Board, axis and limits, for JSON: only a sequence with the same subject is continued.
    """

    folder: Path
    subject: Mapping[str, Any]
    done: dict[str, Done] = field(default_factory=dict)  # by the name of the step, in their order

    @classmethod
    def opened(cls, folder: Path, subject: Mapping[str, Any]) -> Pack:
        """New pack, or the one that is in the folder.

        Raises
        ------
        PackError
            If the one in the folder is damaged or has another subject.
        """
        path = folder / PROGRESS
        if not path.exists():
            return cls(folder, subject)
        remedy = "write another folder with --out, or remove this one"
        try:
            known = parse_json(read_text(path))
            found = {name: _done(one) for name, one in known["steps"].items()}
            before = known["subject"]
        except (TextFileError, KeyError, TypeError, AttributeError) as error:
            raise PackError(f"{path} is damaged ({error}); {remedy}") from None
        changed = [name for name in subject if before.get(name) != subject[name]]
        if changed:
            text = "; ".join(f"{name} was {before.get(name)}, now {subject[name]}" for name in changed)
            raise PackError(f"{folder} belongs to another commissioning: {text}; {remedy}")
        return cls(folder, subject, found)

    def keep(self, name: str, done: Done) -> None:
        """Save the result of a step."""
        self.done[name] = done
        self._save()

    def forget(self, names: Sequence[str]) -> None:
        """Remove the results of steps."""
        for name in names:
            self.done.pop(name, None)
        self._save()

    def _save(self) -> None:
        steps = {
            name: {
                "figures": [figure.document() for figure in one.figures],
                "texts": list(one.texts),
                "pictures": list(one.pictures),
            }
            for name, one in self.done.items()
        }
        document = {"subject": dict(self.subject), "steps": steps}
        write_file(self.folder / PROGRESS, json.dumps(document, indent=2, allow_nan=False) + "\n")


def _done(document: Mapping[str, Any]) -> Done:
    figures = [Figure.of_document(one) for one in document["figures"]]
    return Done(figures, list(document["texts"]), list(document["pictures"]))

"""What earlier versions accepted and this one does not, and the sentence for each."""

_STUDY = "is a study of the repository now: `python -m studies.coverage OUT`"
COMMANDS: dict[str, str] = {
    "coverage": f"`sunspin coverage` {_STUDY}",
    "worth": f"`sunspin worth` {_STUDY}",
}
OPTIONS: dict[str, str] = {
    "--device": "--device is gone, kernels run on processors only; leave it out",
}

"""What earlier versions accepted and this one does not, and the sentence for each."""

_STUDY = "is a study of the repository now: `python -m studies.coverage OUT`"
COMMANDS: dict[str, str] = {
    "coverage": f"`sunspin coverage` {_STUDY}",
    "worth": f"`sunspin worth` {_STUDY}",
}
OPTIONS: dict[str, str] = {
    **{
        f"--{name}": f"--{name} is --{name}-deg-s now, and its rates are in deg/s"
        for name in ("omega", "omega-x", "omega-y", "omega-z", "rate", "gyro", "max-rate")
    },
    "--interpolate": "--interpolate is gone, every motion of a scan is run; leave it out",
    "--device": "--device is gone, kernels run on processors only; leave it out",
    "--best-delay": "--best-delay is gone; compare delays by --strategy delay:SECONDS, given several times",
    "--data": "--data of `sunspin reproduce` is gone, the impulse is a study: `python -m studies.impulse OUT --data FOLDER`",
    "--noise": "--noise of `sunspin rates` is --acceleration-noise now, in rad/s^1.5",
    "--no-wirings": "--no-wirings is --no-column-tests now",
    "--printed-lines": "--printed-lines is gone, these lines are of the paper's body; give --omega-deg-s x,y,z or --scan scan.nc",
}

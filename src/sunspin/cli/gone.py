"""What earlier versions accepted and this one does not, and the sentence for each."""

COMMANDS: dict[str, str] = {}
OPTIONS: dict[str, str] = {
    "--interpolate": "--interpolate is gone, every motion of a scan is run; leave it out",
    "--device": "--device is gone, kernels run on processors only; leave it out",
    "--best-delay": "--best-delay is gone; compare delays by --strategy delay:SECONDS, given several times",
    "--printed-lines": "--printed-lines is gone, these lines are of the paper's body alone; give --omega x,y,z or --scan scan.nc",
}

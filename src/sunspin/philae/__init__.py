"""The Philae study: from telemetry to conclusions, each figure of the paper compared with ours, pictures and page."""

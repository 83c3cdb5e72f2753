"""What `sunspin check` says of files, samples and orbits, as data and in lines."""

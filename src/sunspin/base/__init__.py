"""What everything rests on: errors that say what to do, reading of untrusted files, files written whole or not at all."""

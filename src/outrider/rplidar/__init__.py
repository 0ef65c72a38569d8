"""The lidars of one maker over a serial line: bytes in, turns out, and the same the other way round."""

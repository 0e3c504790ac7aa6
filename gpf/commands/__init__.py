"""The commands of the library: `gpf fit`, `gpf render`, `gpf demo`."""

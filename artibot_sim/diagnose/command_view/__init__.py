"""The command view: commands in, motor speeds and torques out; what acts on the way of a command shows here."""

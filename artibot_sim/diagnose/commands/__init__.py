"""The command view: commands in, motor speeds and torques out."""

"""Which effects are named: evidence, joint fits, forward selection, backward elimination, ranking."""

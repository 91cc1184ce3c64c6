"""``previs bench --speed``: what a picture costs and where, against the least that it could cost and against plain
ways to draw it.

`ways` says what is compared, `clock` times it, `accuracy` measures how far it is from the truth, `scenes` does both on
stages; `scaling` fits how costs grow, `peer` compares with VTK where it is installed, `report` writes it all down.
"""

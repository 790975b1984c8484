"""All scans together: wall faces, doors, windows, floors and ceilings of the building, and each return's final label.

fusion calls the steps in order. model holds their types, votes what scans said of each cube of space, evidence what rays
found at each face, and parse what each stretch of it is.
"""

"""Run by pvbatch: what ParaView sees in the folders of runs, as JSON.

pvbatch look_in_paraview.py ANSWER.json FOLDER ...
"""

import json
import os
import sys

from paraview.simple import *


def main(answer, *folders):
    seen = {}
    for folder in folders:
        seen[folder] = {"fields": fields(os.path.join(folder, "fields.pvd"))}
        if os.path.isfile(os.path.join(folder, "contact.pvd")):
            seen[folder]["contact"] = contact(os.path.join(folder, "contact.pvd"))
    with open(answer, "w") as file:
        json.dump(seen, file)


def fields(path):
    reader = PVDReader(FileName=path)
    times = list(reader.TimestepValues)
    frames = [frame(reader, time) for time in (times[0], times[-1])]
    stress = reader.CellData["stress"]
    names = [stress.GetComponentName(k) for k in range(stress.GetNumberOfComponents())]
    return {"times": times, "frames": frames, "components": names}


def frame(reader, time):
    reader.UpdatePipeline(time)
    ranges = {
        name: list(reader.CellData[name].GetRange(0))
        for name in ("von_mises", "J", "body", "side", "fraction")
    }
    ranges["stress XX"] = list(reader.CellData["stress"].GetRange(0))
    cells = reader.GetDataInformation().GetNumberOfCells()
    back = WarpByVector(Input=reader, Vectors=["POINTS", "displacement"], ScaleFactor=-1.0)
    back.UpdatePipeline(time)
    x0, x1, y0, y1, _, _ = back.GetDataInformation().GetBounds()
    return {"cells": cells, "ranges": ranges, "warped back": [x0, y0, x1, y1]}


def contact(path):
    reader = PVDReader(FileName=path)
    times = list(reader.TimestepValues)
    reader.UpdatePipeline(times[-1])
    cells = reader.GetDataInformation().GetNumberOfCells()
    return {"times": times, "cells": cells, "pressure": list(reader.CellData["pressure"].GetRange(0))}


main(*sys.argv[1:])

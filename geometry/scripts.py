"""Whether a gmsh script only describes geometry.

A .geo script can run programs, read and write files and end the process. What is vetted here is what gmsh
gets to see: comments are taken out, line ends made alike, and every word outside strings must be one that
describes geometry, or a name to which the script itself gives a value. The rules follow gmsh's own scanner and
grammar (src/parser/Gmsh.l and Gmsh.y of gmsh 4.15).
"""

from __future__ import annotations

import re

REFUSED = frozenset(
    # run, read or write something
    "SystemCall System NonBlockingSystemCall Include Merge MergeWithBoundingBox ShapeFromFile ListFromFile "
    "OnelabRun OnelabAction SendToServer Solver Plugin Save Print CreateDir FileName CommandLine "
    "ExternalProcess PostView Structured GetEnv GetString GetValue SetString SetNumber View "
    "PostProcessing General "
    # build the name of a command from a string
    "StringToName S2N "
    # end or wait
    "Exit Abort Sleep "
    # turn the geometry into something else
    "NewModel Combine CreateTopology CreateGeometry ClassifySurfaces PartitionMesh OptimizeMesh".split()
)
"""Commands refused even where the script gives a value to the name (gmsh's grammar takes most of them as plain
names, which a script may also use for its variables)."""

ALLOWED = frozenset(
    # entities
    "Point Line Curve Circle Ellipse Spline BSpline Bezier Nurbs CatmullRom Compound Loop Wire Surface Plane Ruled "
    "Filling Patch ThruSections Volume Rectangle Disk Torus Sphere Box Cylinder Cone Wedge Physical Parametric "
    "Elliptic ArcLength Order Knots Using Sewing In Closest Parent Unit Normal Mass Center CenterOfMass Mesh "
    "Geometry Periodic Affine Transfinite Recombine Left Right Alternate AlternateLeft AlternateRight Progression "
    "Bump Beta TransfQuadTri Smoother RefineMesh MeshAlgorithm MeshSize MeshSizeFromBoundary Characteristic Length "
    "Field Attractor Background Distance Threshold Min Max Constant MathEval Restrict Cylinder Frustum BoundaryLayer "
    # operations
    "Translate Rotate Symmetry Dilate Extrude Layers QuadTriAddVerts QuadTriNoNewVerts ScaleLastLayer Duplicata "
    "Boundary CombinedBoundary PointsOf BoundingBox Coherence BooleanUnion BooleanDifference BooleanIntersection "
    "BooleanFragments Fillet Chamfer Delete Recursive Hide Show Reverse Split Color Intersect Embedded Unique "
    "Homology Cohomology Degenerated Extend ThickSolid SetFactory SetPartition SetTag SetMaxTag MaxTag "
    # values and control
    "If ElseIf Else EndIf For EndFor In Function Macro Return Call DefineConstant DefineNumber DefineString "
    "UndefineConstant SetName GetNumber Exists StrPrefix StrRelative StrFind StrCmp "
    "StrLen StrChoice StrSub StrReplace StrCat Str Sprintf Printf Error Warning UpperCase LowerCase "
    "LowerCaseIn NameToString List LinSpace LogSpace Catenary Abs Acos ArcCos "
    "Asin ArcSin Atan ArcTan Atan2 ArcTan2 Ceil Cos Cosh Exp Fabs Floor Fmod Modulo Hypot Log Log10 Rand Round Sin "
    "Sinh Sqrt Square Step Tan Tanh Pi MPI_Rank MPI_Size Cpu Memory TotalMemory newp newl newc newll newcl news "
    "newsl newv newreg newf Name Min Max Step Range Choices ReadOnly Visible Label Help e E "
    "newreg Today GMSH_MAJOR_VERSION GMSH_MINOR_VERSION GMSH_PATCH_VERSION".split()
)
"""Words that describe geometry and compute values."""

LONGEST_STRING = 1000
"""gmsh reads what follows the first 1023 characters of a string as commands."""

_STRING = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'")
_WORD = re.compile(r"(?<![\w.])(?:\d+\.?\d*|\.\d+)[eE][+-]?\d+|(?P<word>[A-Za-z_]\w*)|(?P<quote>[\"'])")
_INTO_FILE = re.compile(r"\b(?:Printf|Error|Warning)\s*\([^;]*\)\s*>")
_ASSIGNED = re.compile(
    r"([A-Za-z_]\w*)\s*(?:~\{[^}]*\})?\s*(?:\[[^\]]*\]|\(\s*\)|\{[^}]*\})?\s*[-+*/]?=(?!=)"
)
_DEFINED = re.compile(r"\b(?:For|Macro|Function)\s+([A-Za-z_]\w*)")
_COMMENT = re.compile(r'"[^"\n]*"|\'[^\'\n]*\'|//[^\n]*|/\*.*?\*/', re.DOTALL)


def cleaned(text: str) -> str:
    """The script without comments, with one kind of line end and a last one; line numbers stay."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")

    def replacement(match: re.Match[str]) -> str:
        found = match.group()
        return found if found[0] in "\"'" else " " + "\n" * found.count("\n")

    return _COMMENT.sub(replacement, text) + "\n"


def objection(text: str) -> str | None:
    """What is wrong with a script that :func:`cleaned` returned, naming command and line; None where all is well."""
    for number, line in enumerate(text.split("\n"), start=1):
        if any(len(string) > LONGEST_STRING for string in _STRING.findall(line)):
            return f"line {number}: a string of more than {LONGEST_STRING} characters"
    bare = _STRING.sub("''", text)
    named = set(_ASSIGNED.findall(bare)) | set(_DEFINED.findall(bare))
    for number, line in enumerate(bare.replace("''", "").split("\n"), start=1):
        for match in _WORD.finditer(line):
            word = match.group("word")
            if match.group("quote"):
                return f"line {number}: a string without an end"
            if word in REFUSED or (word and word not in ALLOWED and word not in named):
                return f"line {number}: the command '{word}'"
    into_file = _INTO_FILE.search(bare)
    if into_file:
        return f"line {bare[: into_file.start()].count(chr(10)) + 1}: the command 'Printf' into a file"
    return None

"""Whether a gmsh script only describes geometry.

A .geo script can run programs, read and write files and end the process. What is vetted here is what gmsh gets
to see: comments are taken out, line ends made alike, and every word outside strings must be one that describes
geometry, or a name which the script itself gives to a value.
"""

from __future__ import annotations

import re

REFUSED = frozenset(
    "SystemCall NonBlockingSystemCall Merge Include ShapeFromFile OnelabRun OnelabReset Print Save Plugin Exit Abort "
    "Parse ParseString Read Fopen Sleep NewModel Draw Combine Import Export ExternalProcess CommandLine "
    "MathEvalAniso PostView Structured SetChanged UnsplitWindow CreateTopology CreateTopologyNoHoles "
    "ClassifySurfaces RelocateMesh OptimizeMesh RefineMesh AdaptMesh PartitionMesh RenumberMeshNodes "
    "RenumberMeshElements ReorientMesh TransformMesh SetOrder GetEnv GetString GetValue OnelabAction "
    "SendToServer Solver View PostProcessing PrintOptions General Run Alias AliasWithOptions Background ".split()
)
"""Commands that run, read, write, wait or end, refused even where the script gives a value to the name."""

ALLOWED = frozenset(
    # entities
    "Point Line Curve Circle Ellipse Spline BSpline Bezier Nurbs CatmullRom Compound Loop Wire Surface Plane Ruled "
    "Filling Patch ThruSections Volume Rectangle Disk Torus Sphere Box Cylinder Cone Wedge Physical Parametric "
    "Elliptic ArcLength Order Knots Using Sewing In Closest Parent Unit Normal Mass Center CenterOfMass Mesh "
    "Geometry Periodic Affine Transfinite Recombine Left Right Alternate AlternateLeft AlternateRight Progression "
    "Bump Beta TransfQuadTri Smoother MeshAlgorithm MeshSize MeshSizeFromBoundary Characteristic Length "
    "Field Attractor Distance Threshold Min Max Constant MathEval Restrict Cylinder Frustum BoundaryLayer "
    # operations
    "Translate Rotate Symmetry Dilate Extrude Layers QuadTriAddVerts QuadTriNoNewVerts ScaleLastLayer Duplicata "
    "Boundary CombinedBoundary PointsOf BoundingBox Coherence BooleanUnion BooleanDifference BooleanIntersection "
    "BooleanFragments Fillet Chamfer Delete Recursive Hide Show Reverse Split Color Intersect Embedded Unique "
    "Homology Cohomology Degenerated SetFactory SetPartition SetTag SetMaxTag MaxTag "
    # values and control
    "If ElseIf Else EndIf For EndFor In Function Macro Return Call DefineConstant DefineNumber DefineString "
    "UndefineConstant SetNumber SetString SetName GetNumber Exists FileExists StrPrefix StrRelative StrFind StrCmp "
    "StrLen StrChoice StrSub StrReplace StrCat Str Sprintf Printf Error Warning UpperCase LowerCase "
    "LowerCaseIn NameToString StringToName List ListFromFile LinSpace LogSpace Catenary Abs Acos ArcCos "
    "Asin ArcSin Atan ArcTan Atan2 ArcTan2 Ceil Cos Cosh Exp Fabs Floor Fmod Modulo Hypot Log Log10 Rand Round Sin "
    "Sinh Sqrt Square Step Tan Tanh Pi MPI_Rank MPI_Size Cpu Memory TotalMemory newp newl newc newll newcl news "
    "newsl newv newreg newf Name Min Max Step Range Choices ReadOnly Visible Label Help e E "
    "newreg Today GMSH_MAJOR_VERSION GMSH_MINOR_VERSION GMSH_PATCH_VERSION".split()
) - {"FileExists", "ListFromFile"}
"""Words that describe geometry and compute values."""

_TOKEN = re.compile(
    r'"(?P<double>[^"\n]*)"|\'(?P<single>[^\'\n]*)\'|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<word>[A-Za-z_]\w*)|(?P<other>.)'
)
_ASSIGNED = re.compile(
    r"([A-Za-z_]\w*)\s*(?:~\{[^}]*\})?\s*(?:\[[^\]]*\]|\(\s*\)|\{[^}]*\})?\s*[-+*/]?=(?!=)"
)
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
    named = set(_ASSIGNED.findall(text)) | set(re.findall(r"\b(?:For|Macro|Function)\s+([A-Za-z_]\w*)", text))
    for number, line in enumerate(text.split("\n"), start=1):
        for match in _TOKEN.finditer(line):
            word = match.group("word")
            if word in REFUSED or (word and word not in ALLOWED and word not in named):
                return f"line {number}: the command '{word}'"
            string = match.group("double") or match.group("single") or ""
            if "\\" in string or match.group("other") in ('"', "'"):
                return f"line {number}: a string with a backslash or an open end"
    into_file = re.search(r"\b(?:Printf|Error|Warning)\s*\([^;]*\)\s*>", text)
    if into_file:
        number = text[: into_file.start()].count("\n") + 1
        return f"line {number}: a Printf into a file"
    return None

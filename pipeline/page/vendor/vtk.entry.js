// What the page uses of vtk.js; README.md says how vtk.min.js is made from this file.
import "@kitware/vtk.js/Rendering/OpenGL/Profiles/Geometry";

export { default as PolyData } from "@kitware/vtk.js/Common/DataModel/PolyData";
export { default as DataArray } from "@kitware/vtk.js/Common/Core/DataArray";
export { default as LookupTable } from "@kitware/vtk.js/Common/Core/LookupTable";
export { default as Actor } from "@kitware/vtk.js/Rendering/Core/Actor";
export { default as Mapper } from "@kitware/vtk.js/Rendering/Core/Mapper";
export { default as Renderer } from "@kitware/vtk.js/Rendering/Core/Renderer";
export { default as RenderWindow } from "@kitware/vtk.js/Rendering/Core/RenderWindow";
export { default as RenderWindowInteractor } from "@kitware/vtk.js/Rendering/Core/RenderWindowInteractor";
export { default as OpenGLRenderWindow } from "@kitware/vtk.js/Rendering/OpenGL/RenderWindow";
export { default as InteractorStyleManipulator } from "@kitware/vtk.js/Interaction/Style/InteractorStyleManipulator";
export { default as PanManipulator } from "@kitware/vtk.js/Interaction/Manipulators/MouseCameraTrackballPanManipulator";
export { default as ZoomManipulator } from "@kitware/vtk.js/Interaction/Manipulators/MouseCameraTrackballZoomManipulator";
export { default as GestureManipulator } from "@kitware/vtk.js/Interaction/Manipulators/GestureCameraManipulator";

"""Draws a frame with VTK; a program of its own, so that nothing of VTK meets the renderer's context.

``python vtk_frame.py IN.npz OUT.npz`` reads what `previs.bench.speed.peer` wrote, and writes the picture (H, W, 3) with
rows from the top, in units of VTK's own, and the times of frames in seconds, (N,) each: wall and processor.
"""

from __future__ import annotations

import sys
import time

import numpy as np

#: Points of the opacity over density.
POINTS = 256


def main(given: str, wanted: str) -> None:
    """Draw, and write what came of it."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    values = dict(np.load(given))
    density = values["density"]
    width, height = (int(n) for n in values["size"])
    image = vtk.vtkImageData()
    image.SetDimensions(*density.shape)
    image.SetOrigin(*values["origin"])
    image.SetSpacing(*values["spacing"])
    image.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(density.ravel(order="F")), deep=True))

    peak, unit = float(density.max()), float(values["spacing"].min())
    opacity = vtk.vtkPiecewiseFunction()
    for value in np.linspace(0.0, peak, POINTS):
        opacity.AddPoint(value, 1.0 - np.exp(-float(values["extinction"]) * value * unit))
    color = vtk.vtkColorTransferFunction()
    for value in (0.0, peak):
        color.AddRGBPoint(value, 1.0, 1.0, 1.0)
    medium = vtk.vtkVolumeProperty()
    medium.SetScalarOpacity(opacity)
    medium.SetScalarOpacityUnitDistance(unit)
    medium.SetColor(color)
    medium.SetInterpolationTypeToLinear()
    medium.ShadeOn()
    medium.SetAmbient(0.0)
    medium.SetDiffuse(1.0)
    medium.SetSpecular(0.0)
    medium.SetScatteringAnisotropy(float(values["anisotropy"]))

    mapper = vtk.vtkOpenGLGPUVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetSampleDistance(unit)
    mapper.SetVolumetricScatteringBlending(2.0)
    mapper.SetGlobalIlluminationReach(1.0)
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(medium)

    renderer = vtk.vtkRenderer()
    renderer.SetBackground(0.0, 0.0, 0.0)
    renderer.AutomaticLightCreationOff()
    renderer.AddVolume(volume)
    light = vtk.vtkLight()
    light.SetLightTypeToSceneLight()
    light.PositionalOff()
    light.SetFocalPoint(*values["middle"])
    light.SetPosition(*(values["middle"] - values["light"]))
    light.SetIntensity(1.0)
    renderer.AddLight(light)

    matrix = values["camera_to_world"]
    camera = vtk.vtkCamera()
    camera.SetPosition(*matrix[3, :3])
    camera.SetFocalPoint(*(matrix[3, :3] - matrix[2, :3]))
    camera.SetViewUp(*matrix[1, :3])
    # At unit distance, or in stage units for a parallel projection.
    left, right, bottom, top = values["window"]
    if values["parallel"]:
        camera.ParallelProjectionOn()
        camera.SetParallelScale(0.5 * (top - bottom))
    else:
        camera.SetViewAngle(float(np.degrees(2.0 * np.arctan(0.5 * (top - bottom)))))
    camera.SetWindowCenter((left + right) / (right - left), (bottom + top) / (top - bottom))
    renderer.SetActiveCamera(camera)
    renderer.ResetCameraClippingRange()

    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(width, height)
    window.AddRenderer(renderer)

    def draw() -> np.ndarray:
        window.Render()
        pixels = vtk.vtkUnsignedCharArray()
        window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, pixels)
        return vtk_to_numpy(pixels).reshape(height, width, 4)[::-1, :, :3].astype(np.float32)

    # Eight bits: the light is set so that they are used and none overflows. This warms up too.
    intensity, picture = 1.0, draw()
    for _ in range(6):
        brightest = float(picture.max())
        if 120.0 <= brightest <= 250.0:
            break
        intensity *= 0.25 if brightest > 250.0 else 200.0 / max(brightest, 1.0)
        light.SetIntensity(intensity)
        picture = draw()
    wall, process = [], []
    for _ in range(int(values["repeats"])):
        camera.Modified()
        begin = time.perf_counter(), time.process_time()
        picture = draw()
        wall.append(time.perf_counter() - begin[0])
        process.append(time.process_time() - begin[1])
    np.savez(
        wanted,
        picture=picture,
        wall=wall,
        process=process,
        version=vtk.vtkVersion().GetVTKVersion(),
        window=window.GetClassName(),
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])

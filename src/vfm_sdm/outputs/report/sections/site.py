"""The site: axes in words, plan and elevation, and first frames with points, subsets and axes."""

from vfm_sdm.outputs.report.content import Block, Cell, Figure, Listed, Paragraph, Section, Table
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language, count_decimals
from vfm_sdm.outputs.report.photos import draw_photo, find_photos
from vfm_sdm.outputs.report.site_plan import draw_site, site_places

__all__ = ["describe_photos", "describe_site"]


def describe_site(inputs: ReportInputs, language: Language) -> Section:
    """Axes with their positive directions, plan, elevation, and where cameras and points are.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    axes = tuple(f"{language.word('axis', axis)}: {language.word('direction', axis)}" for axis in inputs.axis_names)
    blocks: list[Block] = [Paragraph(language.say("axes head")), Listed(axes)]
    places = site_places(inputs)
    if not places:
        blocks.append(Paragraph(language.say("no cameras"), "quiet"))
        return Section(language.say("title site"), tuple(blocks))
    for view in ("plan", "elevation"):
        blocks.append(Figure(language.say(f"figure {view}"), draw_site(inputs, places, view, language)))
    rows = tuple(
        (
            Cell(place.name),
            Cell(language.say("camera" if place.sight is not None else "static point" if place.static else "point")),
            *(language.cell(float(value), 3) for value in place.position),
        )
        for place in places
    )
    columns = ("name", "what", *(f"{language.word('axis', axis)} [m]" for axis in inputs.axis_names))
    blocks.append(
        Table(
            language.say("table places"),
            (language.say(columns[0]), language.say(columns[1]), *columns[2:]),
            rows,
            words=2,
        )
    )
    baseline = inputs.displacement.attrs.get("baseline_m")
    if baseline is not None and len(inputs.session.view) > 1:
        blocks.append(
            Paragraph(language.say("baseline is", metres=language.write(baseline, count_decimals(baseline, 4))))
        )
    return Section(language.say("title site"), tuple(blocks))


def describe_photos(inputs: ReportInputs, language: Language) -> Section:
    """First frames of all views, or why they are not there.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    blocks: list[Block] = []
    for photo in find_photos(inputs):
        if photo.reason:
            blocks.append(Paragraph(language.say(photo.reason, view=photo.view), "quiet"))
        if svg := draw_photo(inputs, photo, language):
            key = "figure photo later" if photo.number else "figure photo"
            key = key if photo.frame is not None else "figure photo kept"
            blocks.append(Figure(language.say(key, view=photo.view, frame=photo.number), svg))
    return Section(language.say("title photos"), tuple(blocks))

"""The text of a SUMO network of one straight edge along x, as netconvert writes it."""


def straight_net(lane_count: int, lane_width: float, length: float, speed_limit: float) -> str:
    """Return the text of a network of one edge from x = 0 to its length, lanes side by side about y = 0.

    Args:
        lane_count: number of lanes.
        lane_width: [m].
        length: [m].
        speed_limit: of all lanes [m/s].
    """
    half = lane_count * lane_width / 2
    names = [f"road_{index}" for index in range(lane_count)]
    lanes = []
    for index, name in enumerate(names):
        y = (index + 0.5) * lane_width - half
        lanes.append(
            f'        <lane id="{name}" index="{index}" speed="{speed_limit:.6g}" length="{length:.6f}" '
            f'width="{lane_width:.6f}" shape="0.00,{y:.6f} {length:.6f},{y:.6f}"/>'
        )
    box = f"0.00,0.00,{length:.6f},0.00"
    east = f'x="{length:.6f}" y="0.00" incLanes="{" ".join(names)}" intLanes=""'
    ends = f'shape="{length:.6f},{-half:.6f} {length:.6f},{half:.6f}"'
    west = 'x="0.00" y="0.00" incLanes="" intLanes=""'
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<net version="1.20" junctionCornerDetail="5" limitTurnSpeed="5.50">',
            f'    <location netOffset="0.00,0.00" convBoundary="{box}" origBoundary="{box}" projParameter="!"/>',
            '    <edge id="road" from="west" to="east" priority="-1" spreadType="center">',
            *lanes,
            "    </edge>",
            f'    <junction id="east" type="dead_end" {east} {ends}/>',
            f'    <junction id="west" type="dead_end" {west} shape="0.00,{half:.6f} 0.00,{-half:.6f}"/>',
            "</net>",
            "",
        ]
    )

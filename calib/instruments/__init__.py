"""Instruments: what sees a target, how exactly, and what it reads; a tracker and a camera behind one interface.

The interface has two sides. Plans and simulations ask an `Instrument` (`calib.instruments.instrument`): what it sees,
how exactly, and how its readings depend on the parameters. A fit has the rows of a table, of one or several
instruments, and asks the kind of each row (`calib.data.kinds.Kind`): it predicts the reading, and its derivative, from
the pose of the target in the measurement frame and the *internals* of the instrument (`calib.model.internals`), numbers
such as those of a lens, which a tracker does not have. What is known of the internals before the fit, and what is
estimated, is made of cell and table by `calib.instruments.internals`. Above the kinds nothing knows a camera: the fit
has poses, internals, and parameters that change either.

Where instrument and target are mounted enters in one place only: the pose T_frame_target of each row
(`calib.model.kinematics.Sightings`), which `Kinematics` makes of one chain, with the frame at its base and the target
at its tip. A second chain plugs in there. Each frame and each target then names its link, the rows are grouped by their
pair of links, each pair has a chain of the same URDF (`calib.robot.chain.chain_between`), and `Kinematics.sightings`
and `Kinematics.linearised` put poses and motions of the groups together in the order of the rows. Rows, kinds,
internals, noise and priors stay as they are; in plans the second chain is one more
`calib.instruments.instrument.Sightline`. docs/developing.md lists the functions that change.
"""

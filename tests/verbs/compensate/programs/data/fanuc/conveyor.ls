/PROG  CONVEYOR
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 2;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
  LINE_TRACK;
  LINE_TRACK_SCHEDULE_NUMBER      : 1;
  LINE_TRACK_BOUNDARY_NUMBER      : 0;
  CONTINUE_TRACK_AT_PROG_END      : FALSE;

/MN
   1:L P[1] 100mm/sec FINE ;
   2:L P[2] 100mm/sec FINE ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   928.108  mm,	Y =    88.383  mm,	Z =   316.297  mm,
	W =   156.348 deg,	P =    -1.933 deg,	R =    48.192 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   910.824  mm,	Y =  -357.569  mm,	Z =   155.835  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg
};
/END

/PROG  SENSORS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 12;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
  LINE_TRACK;
  LINE_TRACK_SCHEDULE_NUMBER      : 0;

/MN
   1:J P[1] 100% FINE ;
   2:  Touch Offset PR[5] ;
   3:L P[2] 100mm/sec FINE ;
   4:  Touch Offset End ;
   5:  Track TAST[1] ;
   6:L P[2] 50cm/min CNT100 ;
   7:  Track End ;
   8:L P[3] 100mm/sec FINE ;
   9:  SOFTFLOAT[1] ;
  10:L P[1] 100mm/sec FINE ;
  11:  SOFTFLOAT END ;
  12:L P[4] 100mm/sec FINE SkipJump,LBL[9] ;
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
P[3]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   689.361  mm,	Y =   289.308  mm,	Z =   461.918  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =   -13.117 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =  1096.403  mm,	Y =   184.738  mm,	Z =    18.061  mm,
	W =  -156.915 deg,	P =    -9.538 deg,	R =    -6.570 deg
};
/END

/PROG  FRAMES
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 9;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:  UFRAME_NUM=2 ;
   2:  UTOOL_NUM[GP1]=1 ;
   3:L P[1] 100mm/sec FINE ;
   4:  UFRAME[3:part]=PR[10] ;
   5:L P[2] 100mm/sec FINE ;
   6:L P[3] 100mm/sec FINE ;
   7:  UTOOL[GP1,3]=PR[11] ;
   8:L P[4] 100mm/sec FINE ;
   9:J P[5] 50% FINE ;
/POS
P[1]{
   GP1:
	UF : F, UT : F,		CONFIG : 'N U T, 0, 0, 0',
	X =   106.140  mm,	Y =  -294.460  mm,	Z =   472.064  mm,
	W =   154.518 deg,	P =     1.173 deg,	R =     3.152 deg
};
P[2]{
   GP1:
	UF : 3, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   410.824  mm,	Y =  -357.569  mm,	Z =   155.835  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg
};
P[3]{
   GP1:
	UF : 1, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   589.308  mm,	Y =    10.639  mm,	Z =   661.918  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =  -103.117 deg
};
P[4]{
   GP1:
	UF : 1, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   454.963  mm,	Y =  -350.259  mm,	Z =   229.208  mm,
	W =  -143.592 deg,	P =   -49.347 deg,	R =  -121.757 deg
};
P[5]{
   GP1:
	UF : 0, UT : 3,	
	J1=   -40.000 deg,	J2=    12.000 deg,	J3=   -20.000 deg,
	J4=    60.000 deg,	J5=   -75.000 deg,	J6=   150.000 deg
};
/END
